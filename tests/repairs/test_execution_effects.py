"""What is seen while a plan is executed: effects that come, come late, stay away or flip back."""

from __future__ import annotations

import asyncio

import pytest
from tests.repairs.lidar_robot import ON, RUNNING, SCAN, Robot, run

from robomend.repairs.execution_values import Ending
from robomend.repairs.looking import first_of
from robomend.repairs.states import StepState
from robomend_client.actions import OK, Action, ActionResult
from robomend_client.literals import Literal, holds

pytestmark = pytest.mark.anyio


async def test_each_action_is_journaled_sent_and_its_effect_seen() -> None:
    robot = Robot()
    done = await run(robot)
    assert done.ending is Ending.DONE
    assert robot.sent == ["power_up(lidar)", "stop_node(driver)", "start_node(driver)"]
    assert robot.journal == [
        "intend r-1:0 power_up(lidar)",
        "settle r-1:0 0",
        "intend r-1:1 stop_node(driver)",
        "settle r-1:1 0",
        "intend r-1:2 start_node(driver)",
        "settle r-1:2 0",
    ]
    assert [report.seen for report in done.steps] == [
        (Literal(ON),),
        (-Literal(RUNNING),),
        (Literal(SCAN), Literal(RUNNING)),
    ]
    assert done.effect_seen


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


async def test_a_stuck_relay_is_told_by_the_missing_effect() -> None:
    robot = Robot()

    async def stuck(robot: Robot, action: Action) -> ActionResult | None:
        return ActionResult(OK) if action.name == "power_up" else None

    robot.behave = stuck
    done = await run(robot)
    assert done.ending is Ending.EFFECT_MISSING
    assert done.mismatch == Literal(ON)
    assert done.reason == "power_up(lidar) answered 'done', but on(lidar) was not seen within 0.3 s"
    assert robot.sent == ["power_up(lidar)"]
    assert not done.effect_seen


@pytest.mark.parametrize(
    ("count", "told"),
    [
        (1, "running(n)"),
        (4, "running(n), ok(t0), ok(t1) and ok(t2)"),
        (5, "running(n), ok(t0), ok(t1) and 2 more"),
        (12, "running(n), ok(t0), ok(t1) and 9 more"),
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


async def test_nothing_acts_on_an_observation_that_went_stale() -> None:
    robot = Robot()

    async def agent_gone(robot: Robot, action: Action) -> ActionResult | None:
        if action.name == "power_up":
            robot.see(RUNNING, None)
        return None

    robot.behave = agent_gone
    done = await run(robot)
    assert done.ending is Ending.STALE
    assert done.mismatch == Literal(RUNNING)
    assert robot.sent == ["power_up(lidar)"]


async def test_an_effect_that_is_already_there_is_not_brought_about_again() -> None:
    robot = Robot()
    robot.see(RUNNING, False)
    done = await run(robot)
    assert done.ending is Ending.DONE
    assert done.steps[1].state is StepState.ALREADY
    assert robot.sent == ["power_up(lidar)", "start_node(driver)"]


async def test_where_power_is_back_without_us_the_rest_of_the_plan_is_not_for_what_is_there() -> None:
    robot = Robot()
    robot.see(ON, True)
    done = await run(robot)
    assert done.ending is Ending.MISMATCH
    assert robot.sent == []
    assert "on already, and not by this plan" in done.reason
