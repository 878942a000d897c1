"""The loop, in one function: read this file first.

    observations ─► OBS ─► conflicts ─► diagnoses ─► choice ─► plan ─► execution ─┐
         ▲                                                                        │
         └──── the effects are looked for in the next observations ◄──────────────┘

`turn` is one round of it and `mend` a whole repair. What they need of the service around them (OBS,
engines, planners, executors, the journal) is a `Repair`; robomend.repairs.live_repair is the real one.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from robomend.diagnosis.result import DiagnosisResult
from robomend.planning.choice import Choice
from robomend.planning.plan import Plan
from robomend.repairs.execution import execute
from robomend.repairs.execution_values import Ending, Execution, Setting


class TurnOutcome(StrEnum):
    """What a turn of the loop came to."""

    HEALTHY = "healthy"  # OBS is what a healthy system would show
    HELPED = "helped"  # not healthy yet, but the diagnosis that was to be repaired is gone
    NO_HELP = "no-help"  # the diagnosis stands; it is remembered as tried
    NOTHING_TO_TRY = "nothing-to-try"  # every diagnosis was tried, is in quarantine, or has no plan
    NOT_APPROVED = "not-approved"
    HALTED = "halted"  # cancelled, or the global stop
    ASK = "ask"  # an action that must not be repeated has an unknown outcome, or policy said no


GO_ON = frozenset({TurnOutcome.HELPED, TurnOutcome.NO_HELP})
"""After these the loop turns again."""

MOST_IDLE = 20
"""Turns of one repair in which the robot changed before anything was done."""


@dataclass(frozen=True, slots=True)
class Turn:
    """The report of one turn."""

    outcome: TurnOutcome
    before: DiagnosisResult
    choice: Choice | None = None
    execution: Execution | None = None
    after: DiagnosisResult | None = None


class Repair(Protocol):
    """One repair of one robot, as the loop sees it."""

    rounds: int  # turns with acts at most, before a person is asked

    async def diagnose(self) -> DiagnosisResult:
        """Return the minimal diagnoses of OBS as it is now, each configured observer heard."""
        ...

    async def choose(self, result: DiagnosisResult) -> Choice | None:
        """Plan for the leading diagnoses; return what to do first, None if the robot changed meanwhile."""
        ...

    async def approved(self, choice: Choice) -> bool:
        """Ask the policy, and a person where it says so; False: cancelled, or overtaken by events."""
        ...

    def setting(self, plan: Plan) -> Setting:
        """Return what the execution of this plan needs."""
        ...

    async def look(self, choice: Choice, execution: Execution) -> DiagnosisResult:
        """Return the diagnosis of the observations that came after the actions."""
        ...

    async def remember(self, choice: Choice, execution: Execution, *, helped: bool) -> None:
        """Keep what was tried, which effect was seen, and whether it helped."""
        ...


async def turn(repair: Repair) -> Turn:
    """One turn of the loop: diagnose, choose, plan, approve, act, and look whether it helped."""
    result = await repair.diagnose()  # OBS -> conflicts -> minimal diagnoses
    if result.healthy:
        return Turn(TurnOutcome.HEALTHY, result)
    choice = await repair.choose(result)  # each planned for; probability over cost
    if choice is None:
        return Turn(TurnOutcome.HELPED, result)
    if choice.plan is None or choice.diagnosis is None:
        return Turn(TurnOutcome.NOTHING_TO_TRY, result, choice)
    if not await repair.approved(choice):
        return Turn(TurnOutcome.NOT_APPROVED, result, choice)
    execution = await execute(choice.plan, repair.setting(choice.plan))  # each effect awaited in OBS
    if execution.ending is Ending.HALTED:
        return Turn(TurnOutcome.HALTED, result, choice, execution)
    after = await repair.look(choice, execution)
    helped = stands_no_more(choice.diagnosis.bad, after)
    await repair.remember(choice, execution, helped=helped)
    if after.healthy:  # that is said of now, and to remember took a moment
        after = await repair.diagnose()
    return Turn(_outcome(execution, after, helped), result, choice, execution, after)


async def mend(repair: Repair) -> Turn:
    """Turn the loop until the robot is healthy or nothing is left to try; return the last turn.

    It ends: each turn that did not help makes one diagnosis less likely to be chosen again, and there are at
    most `repair.rounds` turns with acts, and MOST_IDLE without.
    """
    acted = idle = 0
    while True:
        last = await turn(repair)
        acted, idle = (acted, idle + 1) if last.execution is None else (acted + 1, idle)
        if last.outcome not in GO_ON or acted >= repair.rounds or idle >= MOST_IDLE:
            return last


def stands_no_more(bad: tuple[str, ...], after: DiagnosisResult) -> bool:
    """Return whether no diagnosis blames any of the repaired components any more."""
    return not any(set(bad) & set(diagnosis.bad) for diagnosis in after.diagnoses)


def _outcome(execution: Execution, after: DiagnosisResult, helped: bool) -> TurnOutcome:
    if after.healthy:
        return TurnOutcome.HEALTHY
    if execution.ending in {Ending.UNKNOWN_OUTCOME, Ending.NOT_PERMITTED}:
        return TurnOutcome.ASK
    return TurnOutcome.HELPED if helped else TurnOutcome.NO_HELP
