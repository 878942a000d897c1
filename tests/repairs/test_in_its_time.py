"""Waits that are as long as the robot needs: by its configuration, by its model, by what is seen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tests.repairs.robot import CONFIG, Robot, robot_on, service, the_repair, with_recalibrate

from robomend.repairs.looking import DENIED

pytestmark = pytest.mark.anyio


def steps_of(repair: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the steps of all rounds."""
    return [step for one in repair["rounds"] for step in one["plan"]]


async def test_what_a_settled_observer_denies_after_an_act_is_not_waited_for(tmp_path: Path) -> None:
    """The agent says `not ok(map)` afresh once the action has answered, and goes on saying so."""
    config = with_recalibrate()
    config["actions"]["recalibrate"] |= {"effect_timeout_s": 60.0, "retries": 0}

    async def in_vain(robot: Robot, name: str, parameter: str) -> int | None:
        if name != "recalibrate":
            robot.broken_topics.clear()
            return None
        return 0

    async with service(tmp_path) as runtime, robot_on(runtime, **config) as robot:
        robot.spoil = in_vain
        await robot.settled()
        robot.broken_topics.add("map")
        repair = await the_repair(runtime, timeout_s=50.0)
    assert robot.done[0] == "recalibrate(mapping)"
    assert repair["rounds"][0]["reason"].endswith(DENIED)
    assert repair["state"] == "repaired"


async def test_no_wait_is_longer_than_the_effect_time_out_that_is_configured(tmp_path: Path) -> None:
    """Nothing else is configured to take long: what was started in vain for 1 s is not waited for again."""

    async def first_in_vain(robot: Robot, name: str, parameter: str) -> int | None:
        robot.do(name, parameter)
        if robot.done.count("start_node(lidar_node)") == 0:
            robot.connected["lidar_node"] = False
        return 0

    async with service(tmp_path) as runtime, robot_on(runtime) as robot:
        robot.spoil = first_in_vain
        await robot.settled()
        robot.connected["lidar_node"] = False
        repair = await the_repair(runtime)
    assert CONFIG["actions"]["start_node"]["effect_timeout_s"] == 1.0
    assert [one["reason"].endswith("within 1 s") for one in repair["rounds"][:1]] == [True]
    assert [wait for wait in repair["waits"] if "verdicts that are about to come" in wait["why"]] == []
