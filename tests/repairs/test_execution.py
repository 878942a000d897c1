"""Executing a plan: side by side, and what keeps a step from being sent or cuts it off."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest
from tests.repairs.lidar_robot import CNF, POWER_LOST, Robot, setting, step
from tests.waiting import for_ever

from robomend.errors import Fenced
from robomend.planning.prediction import Prediction, Theory
from robomend.repairs.execution import execute
from robomend.repairs.execution_values import MOST_FEEDBACK, Ending, StepReport
from robomend_client.actions import OK, REFUSED, Action, ActionResult, Feedback
from robomend_client.literals import Atom

pytestmark = pytest.mark.anyio


async def test_stopping_sends_nothing_more_and_cuts_off_what_runs() -> None:
    robot = Robot()
    here = setting(robot)

    async def stop_in_the_middle(robot: Robot, action: Action) -> ActionResult | None:
        if action.name == "stop_node":
            here.halt.set()
            await for_ever()
        return None

    robot.behave = stop_in_the_middle
    done = await execute(POWER_LOST, here)
    assert done.ending is Ending.HALTED
    assert robot.sent == ["power_up(lidar)", "stop_node(driver)"]
    assert robot.journal[-1] == "settle r-1:1 5"


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
