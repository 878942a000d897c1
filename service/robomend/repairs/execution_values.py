"""What an execution needs and what it reports: its setting, how long things may take, how each step ended.

execution.py carries plans out, live_repair.py supplies the setting, record.py writes the reports.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Protocol

from robomend.planning.plan import Step
from robomend.planning.prediction import OBSERVED_FACTS, Prediction
from robomend.repairs.states import StepState
from robomend_client.actions import (
    CANCELLED,
    FAILED,
    REFUSED,
    TIMED_OUT,
    UNREACHABLE,
    Action,
    ActionResult,
    Executor,
)
from robomend_client.literals import Atom, Literal

MAY_HAVE_ACTED = frozenset({TIMED_OUT, CANCELLED})
"""Results after which nobody knows whether the action acted."""

OWN_S = 30.0
"""What an action of the user's own may take of which nobody says anything: a program with rclpy needs seconds
to begin."""


class FreshObs(Protocol):
    """OBS as the execution sees it: only what is fresh."""

    @property
    def revision(self) -> int:
        """Increases with every accepted change."""
        ...

    def value(self, atom: Atom) -> bool | None:
        """Return whether the atom is observed to hold; None: nobody knows, the observation is stale, or it is
        from before an act that may have changed it.
        """
        ...

    def reported(self, atom: Atom) -> bool:
        """Return whether somebody reports the atom, be it from before an act."""
        ...

    def settling_s(self, atom: Atom) -> float:
        """Return how long its observers may need to say anew what they say of the atom; 0: they did."""
        ...

    def turns_s(self, atom: Atom, acted_ns: int) -> float:
        """Return in how many seconds an observer that says that something does not hold cannot say otherwise
        any more, of what an act that answered then has brought back.
        """
        ...

    def may_take_s(self, missing: Collection[Literal], sent_ns: int, answered_ns: int) -> float:
        """Return in how many seconds one of these, awaited of that act, will have had more than its time, by
        what is known of earlier starts; inf: nothing is.
        """
        ...

    def due_s(self, missing: Collection[Literal], usual_s: float) -> float:
        """Return in how many seconds the last of these may be due, by how long what they rest on takes to
        boot and to start (a driver `usual_s` after its device, where nothing is known of it); below 0:
        nothing says that any is due later than now.
        """
        ...

    def rose_ns(self, atom: Atom) -> int | None:
        """Return since when something that holds is known to; None: nobody knows."""
        ...

    def fell_ns(self, atom: Atom) -> int | None:
        """Return until when something held that does not any more; None: it does, or nobody knows."""
        ...

    def denied_s(self, missing: Collection[Literal], sent_ns: int, answered_ns: int) -> float:
        """Return in how many seconds the observer of one of these, which says since that act that it is not
        so, will have settled; inf: none says so, or what it rests on has begun since.
        """
        ...

    async def changed(self, revision: int, timeout_s: float) -> int:
        """Return the revision once it is above `revision`, or the present one after the time-out."""
        ...


class Journal(Protocol):
    """What must be on disk before an action is sent, and after its outcome is known.

    How far the step is goes with it, so that one write does for both.
    """

    async def intend(self, action: Action, report: StepReport) -> None:
        """Write the intent. Withheld: a stop or a cancellation is on disk already, so nothing is sent."""
        ...

    async def settle(self, action: Action, result: ActionResult, report: StepReport) -> None:
        """Write the outcome. An action in doubt (see not_idempotent) is left open instead."""
        ...


class Withheld(Exception):  # an answer of the journal, not an error
    """The journal refuses an intent: whoever asked for the end was faster. The argument is the reason."""


Confirm = Callable[[], Awaitable[None]]
"""Awaited right before anything is sent: returns while the robot is ours for certain, else raises Fenced."""


async def nobodys() -> None:
    """Confirm it where nobody owns robots, so that none can be lost."""


@dataclass(frozen=True, slots=True)
class Timing:
    """How long each thing may take, in seconds. Per action name, with a default."""

    action_timeout_s: float = 10.0  # for the executor's answer
    effect_timeout_s: float = 5.0  # from the answer to the effect in OBS
    retries: int = 1  # of an action that reported failure or could not be sent
    backoff_s: float = 0.5  # before the first retry; doubles
    hold_s: float = 0.5  # a contradiction shorter than this is a flutter


class Ending(StrEnum):
    """Why an execution ended."""

    DONE = "done"
    ACTION_FAILED = "action-failed"
    EFFECT_MISSING = "effect-missing"
    MISMATCH = "mismatch"  # OBS contradicts the predicted state
    NOT_PERMITTED = "not-permitted"
    STALE = "stale"  # a precondition is no longer observed: nothing acts on old news
    UNKNOWN_OUTCOME = (
        "unknown-outcome"  # an action that must not be repeated, and nobody knows whether it acted
    )
    HALTED = "halted"  # cancelled, or the global stop


MOST_FEEDBACK = 1000
"""Characters of a feedback's message that are kept."""


@dataclass(frozen=True, slots=True)
class LatestFeedback:
    """How far an action is, in the words of who carries it out; what the number means is theirs to say."""

    code: int
    message: str
    time_ns: int


@dataclass(frozen=True, slots=True)
class StepReport:
    """What became of one step."""

    step: Step
    state: StepState = StepState.WAITING
    action_id: str | None = None
    result: ActionResult | None = None
    seen: tuple[Literal, ...] = ()  # awaited effects that OBS showed
    missing: tuple[Literal, ...] = ()  # … and that it did not
    reason: str = ""
    sent_ns: int | None = None
    ended_ns: int | None = None
    feedback: LatestFeedback | None = None


@dataclass(frozen=True, slots=True)
class Execution:
    """The report of one plan's execution."""

    ending: Ending
    reason: str
    steps: tuple[StepReport, ...]
    mismatch: Literal | None = None  # what was expected and not seen
    kept: frozenset[str] = frozenset()  # what was good before its step came, and was not touched

    @property
    def effect_seen(self) -> bool:
        """Every action that was sent did what it is for: its device is on, its process runs.

        That a topic stayed silent all the same is no doubt about the action, but about the diagnosis.
        """
        return all(
            report.result is not None
            and report.result.ok
            and not any(literal.atom.predicate in OBSERVED_FACTS for literal in report.missing)
            for report in self.steps
            if report.sent_ns is not None
        )


async def _unknown(step: Step) -> str | None:
    return None


async def _for_something() -> str | None:
    return None


@dataclass(frozen=True)
class Setting:
    """Everything a plan's execution needs of the outside."""

    repair: str  # the repair's id; actions are called `repair:step`
    first_step: int  # number of this plan's first step within the repair
    sight: FreshObs
    prediction: Prediction
    executors: Mapping[str, Executor]  # action name -> who carries it out
    journal: Journal
    permit: Callable[[Step], Awaitable[str | None]]  # None, or why not
    halt: asyncio.Event  # set by cancel and by the global stop
    interlocked: Callable[[], str | None]  # asked right before an action is sent: None, or why it is not
    again: Callable[[Step], str | None]  # asked before a failed action is sent again: None, or why not
    observed: frozenset[Atom]  # atoms that some observer of this robot reports
    timing: Mapping[str, Timing] = field(default_factory=dict)
    default_timing: Timing = Timing()
    not_idempotent: Collection[str] = ()  # actions that must not be sent twice when their outcome is unknown
    answers_s: Callable[[Step], float] = lambda step: 0.0  # what who carries it out needs for its answer
    confirm: Confirm = nobodys
    report: Callable[[StepReport], Awaitable[None]] | None = None  # called at each change of a step
    later: Callable[[Step], int] = lambda step: 0  # of steps that may begin now, the least comes first
    well: Callable[[Step], Awaitable[str | None]] = _unknown  # asked before a step acts on what is bad: None,
    # or by what evidence that is good by now, and not to be touched
    moot: Callable[[], Awaitable[str | None]] = _for_something  # asked before the first act: None, or why the
    # plan is for nothing by now, though what it was made for still fails

    def timing_of(self, step: Step) -> Timing:
        """Return the bounds of this step."""
        timing = self.timing.get(step.name, self.default_timing)
        return replace(timing, action_timeout_s=max(timing.action_timeout_s, self.answers_s(step)))


WHAT_HAPPENED = {
    FAILED: "failed",
    REFUSED: "was refused",
    TIMED_OUT: "was sent, and its outcome is unknown",
    UNREACHABLE: "could not be carried out",
    CANCELLED: "was cancelled by who carries it out",
}


def failure(step: Step, result: ActionResult) -> str:
    """Return the sentence that tells of an action which did not succeed."""
    what = WHAT_HAPPENED.get(result.code, f"ended with result {result.code}")
    return f"{step} {what}: {result.message}" if result.message else f"{step} {what}"


RUNS_ALREADY = "runs already"
"""What an agent says that was to start a process and found it there."""


def found_running(name: str, message: str) -> bool:
    """Return whether an action found a process that it was to start; the plan takes it to have ended."""
    return name == "start_node" and RUNS_ALREADY in message


def timings(configured: Mapping[str, Mapping[str, object]], once: Collection[str]) -> dict[str, Timing]:
    """Return action name -> its bounds, by the robot's `actions`; the others have the defaults.

    What must not be repeated (`once`) is retried only if that is configured.
    """
    careful = {name: {"retries": 0} for name in once}
    return {
        name: _timing({**careful.get(name, {}), **_given(configured.get(name, {}))})
        for name in {*configured, *once}
    }


def _given(value: Mapping[str, object]) -> dict[str, object]:
    return {key: one for key, one in value.items() if one is not None}


def _timing(value: Mapping[str, object]) -> Timing:
    names = {"timeout_s": "action_timeout_s", "effect_timeout_s": "effect_timeout_s", "retries": "retries"}
    given = {name: value[key] for key, name in names.items() if key in value}
    return Timing(**given)  # type: ignore[arg-type]  # checked by the wire model
