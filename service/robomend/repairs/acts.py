"""The acts of one repair: its journal, how often each was done, what it switched off, whether it may be sent.

    intend ──► on disk, counted ──► sent ──► settle ──► on disk: the answer, and what is left off by it

Implements the Journal of robomend.repairs.execution_values; `Repeats` and left_off.py have the rules.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from robomend.planning.plan import Step
from robomend.planning.policy import TAKES_AWAY
from robomend.planning.prediction import OBSERVED_FACTS
from robomend.repairs.execution_values import MAY_HAVE_ACTED, StepReport, Withheld, found_running
from robomend.repairs.left_off import given_by, still, taken_by
from robomend.repairs.record import ActionRecord
from robomend.repairs.states import StepState
from robomend.robots.clock import CLOCK
from robomend.robots.robot import Robot
from robomend.store import Store, repairs
from robomend.store.records import Json
from robomend_client.actions import NO_PROGRAM, NOT_EXECUTABLE, REFUSED, Action, ActionResult
from robomend_client.literals import Literal

# --- whether an act is worth doing once more in the same repair: three times, unless something else was seen.
#
# What acts on a device, once: see robomend.planning.cures.once.
#
#     sent ──► seen then ──► asked again: the same is seen now? ── no ──► new evidence: counted anew
#                                               │ yes
#                                               ▼
#                        three times, or two plain answers ──► not again; another way, or a person
#
# New evidence is an observation with another sign than when the act was last sent, what the act itself
# switches left out: a process that is started, runs for a moment and is gone again proves nothing. A plain
# answer is one that the same again does not change: refused, a faulty channel, no such program.

MOST = 3
"""Times that an act is done in a repair without new evidence."""

MOST_PLAIN = 2
"""Plain answers after which it is not done again in this repair."""

PLAIN: Mapping[int, str] = {
    REFUSED: "it was refused",
    NO_PROGRAM: "there is no such program",
    NOT_EXECUTABLE: "the program cannot be executed",
}
"""Answers that the same again does not change."""


@dataclass(slots=True)
class _Act:
    """What became of one act so far."""

    sent: int = 0  # times without new evidence
    seen: frozenset[Literal] = frozenset()  # what was known when it was last sent
    plain: int = 0
    in_vain: bool = False  # carried out wholly and awaited, and the same again cures no better
    said: str = ""  # what the last plain one said; its own words are told with the round that it ended


class Repeats:
    """The acts of one repair."""

    def __init__(self, steps: Iterable[Mapping[str, Any]] = ()) -> None:
        """`steps`: what is on disk of the repair's steps, after a crash."""
        self._acts: dict[str, _Act] = {}
        for step in steps:
            if step.get("sent_ns") is None:
                continue
            act = self._acts.setdefault(step["text"], _Act())
            # The id of a step's second sending ends with `.1`.
            times = 1 + int(str(step.get("id") or "").partition(":")[2].partition(".")[2] or 0)
            act.sent += times
            if step.get("result") in PLAIN:
                act.plain += times
                act.said = PLAIN[step["result"]]

    def sent(self, action: Action, known: Iterable[Literal]) -> None:
        """An action is sent; `known` is OBS."""
        act = self._acts.setdefault(str(action), _Act())
        seen = _relevant(known, action.parameters)
        if _new(act, seen):
            act.sent, act.in_vain = 0, False
        act.sent += 1
        act.seen = seen

    def not_sent(self, action: Action) -> None:
        """It was not sent after all."""
        self._acts[str(action)].sent -= 1

    def answered(self, action: Action, result: ActionResult) -> None:
        """Its answer has come."""
        act = self._acts[str(action)]
        if result.code in PLAIN:
            act.plain += 1
            act.said = PLAIN[result.code]

    def in_vain(self, texts: Iterable[str]) -> None:
        """These were carried out, their effects were awaited in vain, and the same again cures no better."""
        for text in texts:
            if text in self._acts:
                self._acts[text].in_vain = True

    def why_not(self, text: str, parameters: Iterable[str], known: Iterable[Literal]) -> str | None:
        """Return why an act is not done once more, or None."""
        act = self._acts.get(text)
        if act is None:
            return None
        if act.plain >= MOST_PLAIN:
            return f"it was sent {act.plain} times in this repair, and each answer was plain: {act.said}"
        if not (act.in_vain or act.sent >= MOST) or _new(act, _relevant(known, parameters)):
            return None
        if act.in_vain:
            return "it was done in this repair without help, and nothing else was observed since"
        return f"it was done {act.sent} times in this repair, and nothing else was observed since"

    def exhausted(self, known: Iterable[Literal]) -> tuple[tuple[str, str], ...]:
        """Return the acts that are not to be planned, each with the reason."""
        literals = tuple(known)
        found = ((text, self.why_not(text, parameters_of(text), literals)) for text in sorted(self._acts))
        return tuple((text, why) for text, why in found if why is not None)


def parameters_of(text: str) -> tuple[str, ...]:
    """Return the parameters of an act as text, `power_up(lidar)`."""
    inside = text.partition("(")[2].removesuffix(")")
    return tuple(inside.split(", ")) if inside else ()


def _relevant(known: Iterable[Literal], parameters: Iterable[str]) -> frozenset[Literal]:
    """Return what may be evidence: not what the act switches itself."""
    own = frozenset(parameters)
    return frozenset(
        literal
        for literal in known
        if not (literal.atom.predicate in OBSERVED_FACTS and own.intersection(literal.atom.args))
    )


def _new(act: _Act, seen: frozenset[Literal]) -> bool:
    return any(-literal in seen for literal in act.seen)


INTERLOCK_S = 2.0
"""How long an action waits for OBS to show the model's `act_when`, before a person hears of it."""

LOOK_S = 0.25
"""How often that wait looks at the clock as well: what grows stale wakes nobody."""


class Acts:
    """See the module."""

    def __init__(
        self, state: Robot, record: ActionRecord, repeats: Repeats, lingering: Iterable[str] = ()
    ) -> None:
        self.attempts: Counter[str] = Counter()  # actions by component in the last hour
        self.lingering = frozenset(lingering)  # nodes that a start found there, and that do not work
        self.settled = 0  # the revision of OBS when the last action had answered
        # what an answered act influences, for the agents that observe it
        self.influences: Callable[[Action, ActionResult, StepReport], Json | None] = _nothing
        self._state = state
        self._record = record
        self._repeats = repeats
        self._components = frozenset(state.system.cnf.components)

    @classmethod
    async def of(cls, store: Store, state: Robot, record: ActionRecord) -> Acts:
        """Return those of a repair, with what is on disk of it after a crash."""
        steps = [step.data for step in await store.read(repairs.steps, record.id)]
        acts = cls(state, record, Repeats(steps))
        for step in steps:
            acts._found(step["name"], step["parameters"], step["state"], step["message"])
        return acts

    # --- what may be planned and sent

    def exhausted(self) -> tuple[tuple[str, str], ...]:
        """Return the acts that are not to be planned, each with the reason."""
        return self._repeats.exhausted(self._state.sight.literals())

    def in_vain(self, texts: Collection[str]) -> None:
        """Note acts that did not help, and that the same again would not help either."""
        self._repeats.in_vain(texts)

    def found_there(self, reports: Iterable[StepReport]) -> frozenset[str]:
        """Note how the steps of a round ended; return the nodes that a start found there, in vain."""
        before = self.lingering
        for report in reports:
            message = "" if report.result is None else report.result.message
            self._found(report.step.name, report.step.parameters, report.state, message)
        return self.lingering - before

    def _found(self, name: str, parameters: Iterable[str], state: str, message: str) -> None:
        if state == StepState.FAILED and found_running(name, message):
            self.lingering = self.lingering.union(parameters)
        elif state == StepState.DONE and name == "stop_node":
            self.lingering = self.lingering.difference(parameters)

    def again(self, step: Step) -> str | None:
        """Return why an act that failed is not sent once more, or None."""
        return self._repeats.why_not(str(step), step.parameters, self._state.sight.literals())

    def left_off(self) -> Mapping[str, int]:
        """Return what is off by our doing; what OBS shows on again, it has had time to, is not."""
        self._record.leave_off(still(self._state, self._record.left_off))
        return self._record.left_off

    async def interlocked(self) -> str | None:
        """Return why nothing may be sent, after a moment in which that may change; None: it may."""
        deadline = time.monotonic() + INTERLOCK_S
        while (why := self._state.interlocked()) is not None and time.monotonic() < deadline:
            await self._state.changed(self._state.revision, LOOK_S)
        return why

    # --- the journal

    async def intend(self, action: Action, report: StepReport) -> None:
        """Write an intent (see Journal), and count it: for the limit per hour, and for this repair."""
        taken = taken_by(report.step, self._state, self._state.expected_stopped)
        if taken is not None:
            self._record.leave_off({**self._record.left_off, taken: CLOCK.now_ns()})
        try:
            await self._record.intend(action, report)
        except Withheld:
            self._brought_back({taken} if taken is not None else ())
            raise
        self._repeats.sent(action, self._state.sight.literals())
        self.attempts.update(report.step.acts_on(self._components))

    async def settle(self, action: Action, result: ActionResult, report: StepReport) -> None:
        """Write an outcome (see Journal)."""
        self.settled = self._state.revision
        if report.sent_ns is None:
            self._repeats.not_sent(action)
        else:
            self._repeats.answered(action, result)
        did_not_act = report.sent_ns is None or result.code not in MAY_HAVE_ACTED
        if result.ok:
            self._brought_back(given_by(report.step))
        elif did_not_act and action.name in TAKES_AWAY:
            self._brought_back(action.parameters)
        await self._record.settle(action, result, report, self.influences(action, result, report))

    def _brought_back(self, names: Collection[str]) -> None:
        """Note that these are on and running again, or were never switched off."""
        left = self._record.left_off
        if not left.keys().isdisjoint(names):
            self._record.leave_off({name: when for name, when in left.items() if name not in names})


def _nothing(action: Action, result: ActionResult, report: StepReport) -> Json | None:
    return None
