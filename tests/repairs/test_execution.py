"""Executing a plan: side by side, what cuts it off, what is seen and what executors answer meanwhile."""

from __future__ import annotations

import asyncio
import re
from dataclasses import replace
from pathlib import Path

import pytest
from tests.repairs.lidar_robot import CNF, ON, POWER_LOST, QUICK, RUNNING, SCAN, Robot, run, setting, step
from tests.waiting import for_ever

from robomend.errors import Fenced
from robomend.planning.plan import Step
from robomend.planning.prediction import Prediction, Theory
from robomend.repairs.execution import execute
from robomend.repairs.execution_values import MOST_FEEDBACK, Ending, StepReport, Timing
from robomend.repairs.looking import Looking, first_of
from robomend_client.actions import FAILED, OK, REFUSED, Action, ActionResult, Feedback
from robomend_client.literals import Atom, Literal, holds

pytestmark = pytest.mark.anyio


async def test_a_stop_that_comes_while_the_intent_is_written_sends_nothing() -> None:
    robot = Robot()
    here = setting(robot)
    intend = robot.intend

    async def halting(action: Action, report: StepReport) -> None:
        await intend(action, report)
        here.halt.set()

    robot.intend = halting  # type: ignore[method-assign]  # a test double of a test double
    done = await execute(POWER_LOST, here)
    assert done.ending is Ending.HALTED
    assert robot.sent == []
    assert robot.journal[-1] == f"settle r-1:0 {REFUSED}"  # the intent is not left open: it was not sent
    assert done.steps[0].sent_ns is None


async def test_who_has_lost_the_robot_after_the_intent_sends_nothing() -> None:
    robot = Robot()

    async def lost() -> None:
        raise Fenced("another instance has it")

    with pytest.raises(Fenced):
        await execute(POWER_LOST, replace(setting(robot), confirm=lost))
    assert robot.journal == ["intend r-1:0 power_up(lidar)"]  # left open, for whoever has it now
    assert robot.sent == []


async def test_steps_that_are_not_ordered_run_side_by_side() -> None:
    robot = Robot(obs={})
    both = asyncio.Barrier(2)

    async def meet(robot: Robot, action: Action) -> ActionResult | None:
        await both.wait()
        return ActionResult(OK)

    robot.behave = meet
    plan = replace(
        POWER_LOST,
        steps=(step(0, "power_up", "lidar"), step(1, "power_up", "camera")),
        initial=frozenset({Atom("off", ("lidar",)), Atom("off", ("camera",))}),
    )
    here = replace(setting(robot), observed=frozenset(), prediction=Prediction(Theory(CNF), (), plan.initial))
    done = await execute(plan, here)
    assert done.ending is Ending.DONE
    assert sorted(robot.sent) == ["power_up(camera)", "power_up(lidar)"]


async def test_feedback_of_an_action_under_way_is_reported_with_its_step_and_stays_with_it() -> None:
    robot = Robot()
    heard = asyncio.Event()
    told: list[StepReport] = []

    class Speaking:
        async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
            feedback(10, "spinning up")
            await heard.wait()
            feedback(90, "x" * 5000)  # more than is kept
            return await robot.execute(action, feedback)

    async def report(report: StepReport) -> None:
        told.append(report)
        if report.feedback is not None:
            heard.set()

    here = setting(robot)
    executors = {**here.executors, "power_up": Speaking()}
    before = asyncio.all_tasks()
    async with asyncio.timeout(60):
        done = await execute(POWER_LOST, replace(here, executors=executors, report=report))
    assert done.ending is Ending.DONE
    first = next(one.feedback for one in told if one.feedback is not None)
    assert (first.code, first.message) == (10, "spinning up")
    latest = done.steps[0].feedback
    assert latest is not None
    assert (latest.code, len(latest.message)) == (90, MOST_FEEDBACK)
    assert latest.time_ns > first.time_ns
    assert done.steps[1].feedback is None
    assert asyncio.all_tasks() == before  # nothing is told after the end


# --- what is seen meanwhile: effects that come, come late, stay away or flip back


async def test_what_a_step_is_about_to_change_may_have_changed_since_it_was_planned() -> None:
    robot = Robot()
    robot.see(RUNNING, False)  # what was to be stopped has ended

    async def slow(robot: Robot, action: Action) -> ActionResult | None:
        if action.name == "power_up":
            await asyncio.sleep(0.3)  # longer than hold_s
        return None

    robot.behave = slow
    assert (await run(robot)).ending is Ending.DONE
    assert robot.sent == ["power_up(lidar)", "start_node(driver)"]


@pytest.mark.parametrize(
    ("count", "told"),
    [
        (4, "running(n), ok(t0), ok(t1) and ok(t2)"),
        (5, "running(n), ok(t0), ok(t1) and 2 more"),
    ],
)
def test_a_reason_names_a_few_of_many_missing_effects_and_what_is_no_topic_first(
    count: int, told: str
) -> None:
    topics = [holds("ok", f"t{number}") for number in range(count - 1)]
    assert first_of([*topics, holds("running", "n")]) == told


async def test_a_flutter_shorter_than_the_hold_time_is_no_mismatch() -> None:
    robot = Robot()

    async def flutter(robot: Robot, action: Action) -> ActionResult | None:
        if action.name == "stop_node":
            robot.see(ON, False)
            await asyncio.sleep(0.01)  # shorter than hold_s
            robot.see(ON, True)
            await asyncio.sleep(0.15)  # longer than hold_s
        return None

    robot.behave = flutter
    assert (await run(robot)).ending is Ending.DONE


async def test_where_power_is_back_without_us_the_rest_of_the_plan_is_not_for_what_is_there() -> None:
    robot = Robot()
    robot.see(ON, True)
    done = await run(robot)
    assert done.ending is Ending.MISMATCH
    assert robot.sent == []
    assert "on already, and not by this plan" in done.reason


# --- what executors answer: failures, silence, an unknown outcome


async def test_an_effect_that_shows_after_a_failure_ends_the_attempts() -> None:
    robot = Robot()
    asked: list[str] = []

    async def acts_and_fails(robot: Robot, action: Action) -> ActionResult | None:
        if action.name == "power_up":
            await robot.do(action)
            return ActionResult(FAILED, "done, but late")
        return None

    async def permit(step: Step) -> str | None:
        asked.append(str(step))
        return None

    robot.behave = acts_and_fails
    more = replace(QUICK, retries=3)
    done = await execute(POWER_LOST, replace(setting(robot), permit=permit, default_timing=more))
    assert done.ending is Ending.DONE
    assert robot.sent.count("power_up(lidar)") == 1
    assert asked.count("power_up(lidar)") == 2  # before it is sent, and before it would be sent again


def test_the_page_names_the_bounds_of_an_action_that_says_nothing_of_them() -> None:
    page = (Path(__file__).parents[2] / "docs" / "repair.md").read_text()
    told = {name: float(value) for name, value in re.findall(r"`(\w+)`(?: \(|, )default (\d+)", page)}
    timing = Timing()
    assert told["timeout_s"] == timing.action_timeout_s
    assert told["effect_timeout_s"] == timing.effect_timeout_s
    assert told["retries"] == timing.retries


async def test_a_hanging_executor_is_cut_off() -> None:
    robot = Robot()

    async def hangs(robot: Robot, action: Action) -> ActionResult | None:
        await for_ever()
        return None

    robot.behave = hangs
    quick = replace(QUICK, action_timeout_s=0.05, retries=0)
    done = await execute(POWER_LOST, replace(setting(robot), default_timing=quick))
    assert done.ending is Ending.ACTION_FAILED
    assert done.reason == "power_up(lidar) was sent, and its outcome is unknown: no answer in 0.05 s"


async def test_an_executor_that_breaks_counts_as_no_answer() -> None:
    robot = Robot()

    async def broken(robot: Robot, action: Action) -> ActionResult | None:
        raise ZeroDivisionError("a driver's mistake")

    robot.behave = broken
    done = await run(robot)
    assert done.ending is Ending.ACTION_FAILED
    assert done.reason == (
        "power_up(lidar) was sent, and its outcome is unknown: "
        "the executor failed: ZeroDivisionError: a driver's mistake"
    )
    assert "settle r-1:0 3" in robot.journal


# --- what is awaited of a step: what somebody observes

WANTED = Literal(SCAN)
MAP = Atom("ok", ("map",))


async def effect(
    robot: Robot, observed: set[Atom], action: str = "start_node"
) -> tuple[list[Literal], list[Literal]]:
    """Await ok(scan) where these atoms are on the robot's `observed` list; nothing moves meanwhile."""
    here = replace(setting(robot), observed=frozenset(observed))
    here.prediction.expected = lambda: frozenset({WANTED})  # type: ignore[method-assign]  # of no plan
    seen, missing, _ = await Looking(here).effect(action, [WANTED], 0.01, 0)
    return list(seen), list(missing)


async def test_an_effect_is_awaited_that_a_list_names_or_obs_has_held_and_no_other() -> None:
    robot = Robot(obs={ON: True, RUNNING: True})
    assert await effect(robot, {ON}) == ([], [])
    assert await effect(robot, {SCAN}) == ([], [WANTED])
    robot.see(SCAN, False)
    assert await effect(robot, set()) == ([], [WANTED])
    robot.see(SCAN, True)
    assert await effect(robot, set()) == ([WANTED], [])


async def test_of_power_nothing_is_awaited_that_was_said_before_the_cut_and_not_since() -> None:
    class SaidBefore(Robot):
        """What is said of the scan is from before the act."""

        def value(self, atom: Atom) -> bool | None:
            return None if atom == SCAN else super().value(atom)

    robot = SaidBefore(obs={ON: True, RUNNING: True, SCAN: True})
    assert await effect(robot, {SCAN}, "power_up") == ([], [])
    assert await effect(robot, {SCAN}) == ([], [WANTED])


async def test_once_one_observer_has_settled_on_no_the_others_are_not_waited_for_beyond_the_time_out() -> (
    None
):
    class Settling(Robot):
        """Who observes the map has to judge it anew."""

        def settling_s(self, atom: Atom) -> float:
            return 3600.0 if atom == MAP else 0.0

    both = frozenset({WANTED, Literal(MAP)})
    here = replace(setting(Settling(obs={SCAN: False})), observed=frozenset({SCAN, MAP}))
    here.prediction.expected = lambda: both  # type: ignore[method-assign]  # of no plan
    async with asyncio.timeout(60):
        _, missing, _ = await Looking(here).effect("start_node", both, 0.01, 0)
    assert set(missing) == both


async def test_an_effect_is_awaited_longer_than_the_time_out_where_its_observer_may_need_longer() -> None:
    class Slow(Robot):
        def settling_s(self, atom: Atom) -> float:
            return 600.0

        async def changed(self, revision: int, timeout_s: float) -> int:
            self.obs[SCAN] = True
            return revision + 1

    here = replace(setting(Slow(obs={SCAN: False})), observed=frozenset({SCAN}))
    here.prediction.expected = lambda: frozenset({WANTED})  # type: ignore[method-assign]  # of no plan
    assert (await Looking(here).effect("start_node", [WANTED], 0.0, 0))[:2] == ((WANTED,), ())


async def test_what_rests_on_an_effect_that_is_missing_is_awaited_no_longer() -> None:
    described = replace(CNF, atoms=(*CNF.atoms, MAP), clauses=(*CNF.clauses, (-5, 6)), variables=6)
    well = {
        Atom(p, (c,))
        for p, c in [("on", "lidar"), ("good", "lidar"), ("running", "driver"), ("good", "driver")]
    }
    here = replace(
        setting(Robot(obs={SCAN: False, MAP: False})),
        prediction=Prediction(Theory(described), described.components, well),
    )
    looking = Looking(here)
    async with asyncio.timeout(60):
        first, second = await asyncio.gather(
            looking.effect("start_node", [WANTED], 0.01, 0),
            looking.effect("start_node", [Literal(MAP)], 600.0, 0),
        )
    assert first[:2] == ((), (WANTED,))
    assert second[:2] == ((), ())  # it is no longer missing, nor was it seen


async def test_what_the_plan_was_made_on_and_is_so_no_longer_is_told_and_not_built_upon() -> None:
    well = {
        Atom(p, (c,))
        for p, c in [("on", "lidar"), ("good", "lidar"), ("running", "driver"), ("good", "driver")]
    }
    robot = Robot(obs={ON: True, RUNNING: False, SCAN: False})  # it ended while it was planned
    here = replace(setting(robot), prediction=Prediction(Theory(CNF), CNF.components, well))
    looking = Looking(here)
    async with asyncio.timeout(60):
        broken, awaited = await asyncio.gather(
            looking.contradiction(), looking.effect("start_node", [WANTED], 600.0, 0)
        )
    assert broken == Literal(RUNNING)
    assert awaited[:2] == ((), ())
