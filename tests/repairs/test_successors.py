"""A process had ended, and the one started in its place is no better: it is started once more, and its device
keeps its power.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
from tests.repairs.robot import Robot, robot_of, the_repair

from robomend.store import attempts


def first_one_mute() -> Callable[[Robot, str, str], Awaitable[int | None]]:
    """Return what makes the first node that is started run, and say nothing."""
    mute = True

    async def spoiled(robot: Robot, name: str, parameter: str) -> int | None:
        nonlocal mute
        if name != "start_node" or not mute:
            return None
        mute = False
        robot.running[parameter] = True
        return 0

    return spoiled


@pytest.mark.anyio
async def test_a_mute_successor_is_replaced_before_its_device_is_suspected(tmp_path: Path) -> None:
    async with robot_of(tmp_path) as (runtime, robot):
        robot.spoil = first_one_mute()
        robot.running["lidar_node"] = robot.connected["lidar_node"] = False
        repair = await the_repair(runtime)
        tried = await runtime.store.read(attempts.tried, "r1")
    assert repair["state"] == "repaired"
    assert robot.done == ["start_node(lidar_node)", "stop_node(lidar_node)", "start_node(lidar_node)"]
    certain = {one.helped: one.data["certain"] for one in tried}
    assert certain == {False: ["lidar_node"], True: []}


@pytest.mark.anyio
async def test_a_device_that_hangs_behind_the_ended_driver_is_cycled_after_a_second_restart(
    tmp_path: Path,
) -> None:
    cycled = False

    async def hangs_until_cycled(robot: Robot, name: str, parameter: str) -> int | None:
        nonlocal cycled
        cycled = cycled or name == "shutdown"
        if name != "start_node" or cycled:
            return None
        robot.running[parameter] = True  # and finds no device
        return 0

    async with robot_of(tmp_path) as (runtime, robot):
        robot.spoil = hangs_until_cycled
        robot.running["lidar_node"] = robot.connected["lidar_node"] = False
        repair = await the_repair(runtime)
    assert repair["state"] == "repaired"
    restart = ["stop_node(lidar_node)", "start_node(lidar_node)"]
    assert robot.done == ["start_node(lidar_node)", *restart, "shutdown(lidar)", "power_up(lidar)", *restart]
