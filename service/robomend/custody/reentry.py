"""Taking up a repair that a crash or a shutdown left, and asking a person what nobody else can know.

    actions without an outcome ──► the agent's answer, else unknown ──► must not be repeated? ──► ask
    a yes that came before we had read it ──► kept                                  │ no
                                                                                    ▼
    fresh observations from here on ◄───────────────────────────────────── go on, or Halted

Durable by re-entry, not by replay: nothing is carried over but what is on disk and what OBS shows.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable

from robomend.custody.case import Halted, approval
from robomend.custody.choosing import Chooser
from robomend.custody.signals import Signals
from robomend.errors import NotFound
from robomend.fleet.robot_state import RobotState
from robomend.repair.book import Book
from robomend.repair.execution_values import Ending
from robomend.repair.executors.agent import AgentQueue
from robomend.store.interface import Store, Transaction
from robomend.store.records import Fence, Intent
from robomend_client.actions import TIMED_OUT

RETRY_S = 1.0
"""An event wakes us; this is for one that was lost."""


class Reentry:
    """See the module; one for each time that a repair is carried out."""

    def __init__(
        self, store: Store, agents: AgentQueue, chooser: Chooser, book: Book, signals: Signals, fence: Fence
    ) -> None:
        self._store = store
        self._agents = agents
        self._chooser = chooser
        self._book = book
        self._signals = signals
        self._fence = fence

    async def take_up(self, state: RobotState) -> int | None:
        """After a crash or a shutdown: give each action that was under way its outcome, or ask.

        Returns the revision since which observers must have been heard; None for a repair that is new.
        """
        question = self._book.data.get("question")
        if not question and not self._book.data.get("rounds"):
            return None
        rounds = self._book.data.get("rounds")
        if not question and rounds and rounds[-1]["ending"] == str(Ending.UNKNOWN_OUTCOME):
            question = look_first(rounds[-1]["reason"])  # the crash came before it was put
        left = await self._store.read(lambda view: view.unsettled(self._book.robot))
        fates = [(intent, *await self._fate(intent)) for intent in left]
        once = self._chooser.not_idempotent(state)
        unknown = [intent_text(i) for i, code, _ in fates if code == TIMED_OUT and i.name in once]
        if unknown:
            question = look_first(
                f"the service ended while {' and '.join(unknown)} was under way, which must not be done twice"
            )

        def settle(tx: Transaction) -> None:
            for intent, code, message in fates:
                tx.settle(intent.id, code, message, fence=self._fence)

        if question:
            # In one write, so that a second crash does not forget the question.
            return await self.ask(question, new=bool(unknown), also=settle)
        await self._recall_approval(settle)
        await self._book.interrupted()
        return await self._store.read(lambda view: view.revision(self._book.robot))

    async def ask(
        self,
        question: str,
        *,
        new: bool = True,
        also: Callable[[Transaction], None] | None = None,
    ) -> int:
        """Let a person look at the robot; Halted unless they say to go on.

        Returns the revision of OBS then: what was observed before they looked may be what they changed.
        """
        if new:
            self._signals.ask()
        await self._book.update("awaiting-approval", reason=question, question=question, also=also)
        if not await self._signals.decided():
            raise Halted
        by = self._signals.by
        await self._book.update(
            "waiting",
            by=by,
            reason=f"{by} looked, and said to go on",
            question=None,
            answers=self._signals.answers(),
        )
        await self._book.interrupted()
        return await self._store.read(lambda view: view.revision(self._book.robot))

    async def _recall_approval(self, settle: Callable[[Transaction], None]) -> None:
        """Settle the journal, and keep a yes that came to the plan in the book before we had read it."""

        def keep(tx: Transaction) -> None:
            settle(tx)
            for number in numbers:
                tx.answer(number, fence=self._fence)

        requests = await self._store.read(lambda view: view.repair_requests(self._book.robot))
        yes = [r for r in requests if r.repair == self._book.id and r.what == "approve"]
        numbers = [request.number for request in yes]
        if yes and self._book.state == "awaiting-approval":
            given = approval(yes[-1].by, (step["text"] for step in self._book.data.get("plan", ())))
            await self._book.update("waiting", by=yes[-1].by, also=keep, approved=given)
        else:
            await self._book.update("waiting", also=keep)

    async def _fate(self, intent: Intent) -> tuple[int, str]:
        """Return what is known of an action whose outcome was not written."""
        with contextlib.suppress(NotFound):
            action = await self._store.read(lambda view: view.agent_action(intent.id))
            loop = asyncio.get_running_loop()
            deadline = loop.time() + intent.timeout_s
            while action.answered and action.code is None and loop.time() < deadline:
                change = self._agents.watch(self._book.robot)
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(RETRY_S):
                        await change.wait()
                action = await self._store.read(lambda view: view.agent_action(intent.id))
            if action.code is None:
                action = await self._agents.withdraw(intent.id, TIMED_OUT, "the service was restarted")
            if action.code is not None:
                return action.code, action.message
        return TIMED_OUT, "the service ended in the middle of it; whether it acted is for OBS to say"


def look_first(doubt: str) -> str:
    """Return the question to a person about an action with an unknown outcome."""
    return f"{doubt}: look at the robot, then approve to go on or cancel"


def intent_text(intent: Intent) -> str:
    """Return the action of an intent as people write it."""
    return f"{intent.name}({', '.join(intent.parameters)})"
