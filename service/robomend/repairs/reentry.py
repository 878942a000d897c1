"""Taking up a repair that a crash or a shutdown left, and asking a person what nobody else can know.

    actions without an outcome ──► the agent's answer, else unknown ──► must not be repeated? ──► ask
    a yes that came before we had read it ──► kept                                  │ no
                                                                                    ▼
    fresh observations from here on ◄───────────────────────────────────── go on, or Halted

Durable by re-entry, not by replay: nothing is carried over but what is on disk and what OBS shows.

A question is put for an action that must not be repeated and may have acted: after a crash, when no answer
came, when a cancellation or the global stop cut it off. The action stays open in the journal until the
question is on disk (`question` of the repair); a repair that ends without an answer leaves the question to
the robot's next repair, which puts it before it does anything else.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from dataclasses import dataclass

from robomend.errors import NotFound
from robomend.repairs.agent_queue import AgentQueue
from robomend.repairs.choosing import Chooser
from robomend.repairs.execution_values import MAY_HAVE_ACTED
from robomend.repairs.record import LOOP, RepairRecord, approval
from robomend.repairs.signals import Declined, Halted, Signals
from robomend.repairs.states import STEP, RepairState, RepairTrigger, StepState, StepTrigger
from robomend.robots.robot import Robot
from robomend.store import Store, Transaction, agent_actions, attempts, journal, observations, repairs
from robomend.store.records import AuditEntry, Fence, Intent
from robomend.transitions import after
from robomend_client.actions import OK, TIMED_OUT
from robomend_client.events import Kind

RETRY_S = 1.0
"""An event wakes us; this is for one that was lost."""


class Reentry:
    """See the module; one for each time that a repair is carried out."""

    def __init__(
        self,
        store: Store,
        agents: AgentQueue,
        chooser: Chooser,
        record: RepairRecord,
        signals: Signals,
        fence: Fence,
    ) -> None:
        self._store = store
        self._agents = agents
        self._chooser = chooser
        self._record = record
        self._signals = signals
        self._fence = fence

    async def take_up(self, state: Robot) -> int | None:
        """After a crash or a shutdown: give each action that was under way its outcome, or ask.

        Returns the revision since which observers must have been heard; None for a repair that is new.
        """
        question = self._record.data.get("question")
        if not question and not self._record.data.get("rounds"):
            return None
        left = await self.left_open(state, "the service was restarted", patient=True)
        if left.in_doubt:
            why = f"the service ended while {left.in_doubt} was under way, which must not be done twice"
            return await self.ask(look_first(why), left)
        if question:
            return await self.ask(question, left, new=False)
        await self._recall_approval(left)
        await self._record.interrupted()
        return await self._store.read(observations.revision, self._record.robot)

    async def ask_about(self, doubt: str, state: Robot) -> int:
        """Let a person look at the robot, after an action in doubt; see `ask`."""
        return await self.ask(look_first(doubt), await self.left_open(state, doubt))

    async def ask(self, question: str, left: LeftOpen, *, new: bool = True) -> int:
        """Let a person look at the robot; Halted unless they say to go on.

        Args:
            left: settled in the write that puts the question, so that a crash forgets neither.
            new: the question was never put before, so that whatever was said earlier does not answer it.

        Returns the revision of OBS then: what was observed before they looked may be what they changed.
        """
        early: set[int] = set()

        def settle(tx: Transaction) -> None:
            if new:
                early.update(request.number for request in repairs.requests(tx, self._record.robot))
            left.settle(tx)

        if new:
            self._signals.ask()
        await self._record.update(RepairTrigger.QUESTIONED, reason=question, question=question, also=settle)
        if not await self._signals.decided():
            cancelled = self._signals.halted_by
            raise Halted if cancelled is None or cancelled in early else Declined
        by = self._signals.by
        await self._record.update(
            RepairTrigger.GO_ON,
            by=by,
            reason=f"{by} looked, and said to go on",
            question=None,
            answers=self._signals.answers(),
        )
        await self._record.interrupted()
        return await self._store.read(observations.revision, self._record.robot)

    async def next_try(self) -> int | None:
        """Return when the first back-off ends of the components that are in quarantine now."""
        entries = await self._store.read(attempts.quarantine, self._record.robot)
        ends = [entry.until_ns for entry in entries if entry.until_ns and entry.until_ns > time.time_ns()]
        return min(ends, default=None)

    async def left_open(self, state: Robot, why: str, *, patient: bool = False) -> LeftOpen:
        """Return the actions that the journal has without an outcome; `patient`: see `_fate`."""
        once = self._chooser.not_idempotent(state, await self._chooser.actions(state))
        intents = await self._store.read(journal.unsettled, self._record.robot)
        intents = tuple(one for one in intents if not repairs.is_change(one.repair))
        fates = [(intent, *await self._fate(intent, why, patient)) for intent in intents]
        return LeftOpen(tuple(fates), once, self._record.id, self._fence)

    async def _recall_approval(self, left: LeftOpen) -> None:
        """Settle the journal, and keep a yes that came to the plan in the book before we had read it."""

        def keep(tx: Transaction) -> None:
            left.settle(tx)
            for number in numbers:
                repairs.answer(tx, number, fence=self._fence)

        requests = await self._store.read(repairs.requests, self._record.robot)
        yes = [r for r in requests if r.repair == self._record.id and r.what == "approve"]
        numbers = [request.number for request in yes]
        if yes and self._record.state is RepairState.AWAITING_APPROVAL:
            given = approval(yes[-1].by, (step["text"] for step in self._record.data.get("plan", ())))
            await self._record.update(RepairTrigger.TAKEN_UP, by=yes[-1].by, also=keep, approved=given)
        else:
            await self._record.update(RepairTrigger.TAKEN_UP, also=keep)

    async def _fate(self, intent: Intent, why: str, patient: bool) -> tuple[int, str]:
        """Return what is known of an action whose outcome was not written.

        `patient`: an agent that is at it gets the action's time to report, unless somebody halts us (Halted).
        """
        with contextlib.suppress(NotFound):
            action = await self._store.read(agent_actions.get, intent.id)
            loop = asyncio.get_running_loop()
            deadline = loop.time() + (intent.timeout_s if patient else 0.0)
            while action.code is None:
                if not action.answered:  # an agent that begins it meanwhile is waited for
                    action = await self._agents.withdraw(intent.id, why)
                elif loop.time() < deadline:
                    change = self._agents.watch(self._record.robot)
                    with contextlib.suppress(TimeoutError):
                        await self._signals.unless_halted(asyncio.wait_for(change.wait(), RETRY_S))
                    action = await self._store.read(agent_actions.get, intent.id)
                else:
                    break
            if action.code is not None:
                return action.code, action.message
        return TIMED_OUT, f"{why}; whether it acted is for OBS to say"


@dataclass(frozen=True, slots=True)
class LeftOpen:
    """The actions that the journal has without an outcome, and what became of them."""

    fates: tuple[tuple[Intent, int, str], ...]  # with code and message of the result
    once: frozenset[str]  # actions that must not be sent twice
    repair: str
    fence: Fence

    @property
    def in_doubt(self) -> str:
        """The actions, in words, of which only a person can say whether they may be sent (again)."""
        return " and ".join(
            intent_text(intent)
            for intent, code, _ in self.fates
            if code in MAY_HAVE_ACTED and intent.name in self.once
        )

    def question(self, why: str) -> str | None:
        """Return the question that a repair leaves when it ends, `why`."""
        doubt = self.in_doubt
        return look_first(f"{doubt} was cut off ({why}), and must not be done twice") if doubt else None

    def settle(self, tx: Transaction) -> None:
        """Write the outcomes, also into the repair's steps, which nobody reports on any more."""
        outcomes = {}
        for intent, code, message in self.fates:
            journal.settle(tx, intent.id, code, message, fence=self.fence)
            text = intent_text(intent)
            tx.note(AuditEntry(LOOP, "action.result", text, intent.robot, message, after={"result": code}))
            outcomes[intent.id] = (code, message)
        for step in repairs.steps(tx, self.repair):
            if StepState(step.state) is StepState.RUNNING:
                # Answered already, if it has no fate: then it was its effect that was awaited.
                seen = (step.data["result"], "nobody waited for its effect any more")
                code, message = outcomes.get(step.data["id"], seen)
                what = StepTrigger.EFFECT_SEEN if code == OK else StepTrigger.WENT_WRONG
                state = after(STEP, StepState.RUNNING, what)
                data = {**step.data, "state": state, "result": code, "message": message}
                data["ended_ns"] = tx.now_ns
                repairs.put_step(tx, self.repair, step.step, state=state, data=data, fence=self.fence)
                tx.emit(Kind.ACTION, self.fence.robot, {"repair": self.repair, **data})


def look_first(doubt: str) -> str:
    """Return the question to a person about an action with an unknown outcome."""
    return f"{doubt}: look at the robot, then approve to go on or cancel"


def intent_text(intent: Intent) -> str:
    """Return the action of an intent as people write it."""
    return f"{intent.name}({', '.join(intent.parameters)})"
