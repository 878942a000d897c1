"""What executors answer while a plan is executed: failures, silence, and an unknown outcome."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from tests.repairs.lidar_robot import POWER_LOST, QUICK, Robot, run, setting
from tests.waiting import for_ever

from robomend.planning.plan import Step
from robomend.repairs.execution import execute
from robomend.repairs.execution_values import Ending, Timing
from robomend_client.actions import FAILED, TIMED_OUT, Action, ActionResult

pytestmark = pytest.mark.anyio


async def test_a_failed_action_is_tried_again_under_a_new_id() -> None:
    robot = Robot()

    async def fails_once(robot: Robot, action: Action) -> ActionResult | None:
        return ActionResult(FAILED, "busy") if action.id == "r-1:1" else None

    robot.behave = fails_once
    assert (await run(robot)).ending is Ending.DONE
    assert "intend r-1:1.1 stop_node(driver)" in robot.journal


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


async def test_an_action_that_must_not_be_repeated_asks_when_its_outcome_is_unknown() -> None:
    robot = Robot()

    async def silent(robot: Robot, action: Action) -> ActionResult | None:
        return ActionResult(TIMED_OUT)

    robot.behave = silent
    done = await execute(POWER_LOST, replace(setting(robot), not_idempotent={"power_up"}))
    assert done.ending is Ending.UNKNOWN_OUTCOME
    assert robot.sent == ["power_up(lidar)"]


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
