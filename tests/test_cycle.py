"""One turn of the loop and what it comes to, against a repair that says what it is told to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import pytest
from tests.repairs.lidar_robot import POWER_LOST, Robot, setting

from robomend.cycle import MOST_IDLE, TurnOutcome, mend, stands_no_more, turn
from robomend.diagnosis.result import Diagnosis, DiagnosisResult
from robomend.planning.choice import Choice
from robomend.planning.plan import Plan, Step
from robomend.repairs.execution_values import Ending, Execution, Setting

pytestmark = pytest.mark.anyio


def blamed(*bad: str) -> DiagnosisResult:
    return DiagnosisResult(("lidar", "driver"), (Diagnosis(bad),), True, None, (), 0.0)


HEALTHY, LIDAR, DRIVER = blamed(), blamed("lidar"), blamed("driver")


async def refuse(step: Step) -> str:
    return "the policy says no"


@dataclass
class Told:
    """A repair of the lidar robot; each turn sees the next two of `seen`: before and after its plan."""

    seen: Sequence[DiagnosisResult]
    rounds: int = 5
    planned: bool = True
    says_yes: bool = True
    refused: bool = False
    halted: bool = False
    changes: int = 0  # how often the robot changes while it is planned for
    calls: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._seen = iter(self.seen)

    async def diagnose(self) -> DiagnosisResult:
        self.calls.append("diagnose")
        return next(self._seen)

    async def choose(self, result: DiagnosisResult) -> Choice | None:
        self.calls.append("choose")
        if self.changes:
            self.changes -= 1
            return None
        plan = POWER_LOST if self.planned else None
        return Choice(result.diagnoses[0], plan, None, (), 0.0, "as the test says")

    async def approved(self, choice: Choice) -> bool:
        self.calls.append("approved")
        return self.says_yes

    def setting(self, plan: Plan) -> Setting:
        around = setting(Robot())
        if self.halted:
            around.halt.set()
        return replace(around, permit=refuse) if self.refused else around

    async def look(self, choice: Choice, execution: Execution) -> DiagnosisResult:
        self.calls.append(f"look {execution.ending}")
        return next(self._seen)

    async def remember(self, choice: Choice, execution: Execution, *, helped: bool) -> None:
        self.calls.append(f"remember {'helped' if helped else 'no help'}")


async def test_a_healthy_robot_is_left_alone() -> None:
    repair = Told([HEALTHY])
    assert (await turn(repair)).outcome is TurnOutcome.HEALTHY
    assert repair.calls == ["diagnose"]


async def test_without_a_plan_nobody_is_asked() -> None:
    repair = Told([LIDAR], planned=False)
    assert (await turn(repair)).outcome is TurnOutcome.NOTHING_TO_TRY
    assert repair.calls == ["diagnose", "choose"]


async def test_what_changed_while_it_was_planned_for_is_diagnosed_anew_and_not_for_ever() -> None:
    repair = Told([LIDAR, HEALTHY], changes=1)
    assert (await mend(repair)).outcome is TurnOutcome.HEALTHY
    assert repair.calls == ["diagnose", "choose", "diagnose"]
    flapping = Told([LIDAR] * 30, changes=30, rounds=3)
    assert (await mend(flapping)).execution is None
    assert flapping.calls.count("choose") == MOST_IDLE
    late = Told([LIDAR] * 30, changes=7, rounds=3)  # what was not done is no try
    assert (await mend(late)).outcome is TurnOutcome.NO_HELP
    assert late.calls.count("look done") == 3


async def test_what_is_not_approved_is_not_done() -> None:
    repair = Told([LIDAR], says_yes=False)
    report = await turn(repair)
    assert (report.outcome, report.execution) == (TurnOutcome.NOT_APPROVED, None)


@pytest.mark.parametrize(
    ("after", "outcome", "remembered"),
    [
        (HEALTHY, TurnOutcome.HEALTHY, "helped"),
        (DRIVER, TurnOutcome.HELPED, "helped"),
        (LIDAR, TurnOutcome.NO_HELP, "no help"),
    ],
    ids=["healthy", "helped", "no help"],
)
async def test_whether_it_helped_is_what_the_diagnosis_afterwards_says(
    after: DiagnosisResult, outcome: TurnOutcome, remembered: str
) -> None:
    repair = Told([LIDAR, after, after])
    report = await turn(repair)
    assert (report.outcome, report.before, report.after) == (outcome, LIDAR, after)
    assert repair.calls[3:5] == ["look done", f"remember {remembered}"]


async def test_that_all_is_well_is_said_of_now_and_not_of_before_it_was_written_down() -> None:
    repair = Told([LIDAR, HEALTHY, LIDAR])
    report = await turn(repair)
    assert (report.outcome, report.after) == (TurnOutcome.HELPED, LIDAR)
    assert repair.calls[3:] == ["look done", "remember helped", "diagnose"]


async def test_a_plan_that_was_cut_off_is_neither_looked_at_nor_remembered() -> None:
    repair = Told([LIDAR], halted=True)
    report = await turn(repair)
    assert report.outcome is TurnOutcome.HALTED
    assert report.execution is not None
    assert repair.calls == ["diagnose", "choose", "approved"]


@pytest.mark.parametrize(("after", "outcome"), [(LIDAR, TurnOutcome.ASK), (HEALTHY, TurnOutcome.HEALTHY)])
async def test_a_step_that_policy_refuses_is_for_a_person_unless_all_is_well(
    after: DiagnosisResult, outcome: TurnOutcome
) -> None:
    repair = Told([LIDAR, after, after], refused=True)
    report = await turn(repair)
    assert report.outcome is outcome
    assert report.execution is not None
    assert report.execution.ending is Ending.NOT_PERMITTED


async def test_the_loop_turns_until_the_robot_is_healthy_and_no_oftener_than_it_may() -> None:
    seen = [LIDAR, DRIVER, DRIVER, DRIVER, DRIVER, HEALTHY, HEALTHY]
    repair = Told(seen)
    assert (await mend(repair)).outcome is TurnOutcome.HEALTHY
    assert repair.calls.count("choose") == 3
    bounded = Told([LIDAR] * 10, rounds=2)
    assert (await mend(bounded)).outcome is TurnOutcome.NO_HELP
    assert bounded.calls.count("choose") == 2


def test_a_diagnosis_stands_as_long_as_one_of_its_components_is_blamed() -> None:
    assert stands_no_more(("lidar",), DRIVER)
    assert not stands_no_more(("lidar", "driver"), DRIVER)
