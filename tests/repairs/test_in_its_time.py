"""Waits that are as long as the robot needs: by its configuration, by its model, by what is seen."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from tests.repairs.robot import (
    CONFIG,
    MODEL,
    SHUT_DOWN,
    Robot,
    robot_on,
    service,
    the_repair,
    with_recalibrate,
)

from robomend.api.runtime import Runtime
from robomend.repairs import live_repair
from robomend.repairs.execution_values import Timing
from robomend.repairs.looking import DENIED

pytestmark = pytest.mark.anyio


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


async def test_no_wait_is_longer_than_the_effect_time_out_that_is_configured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every action of the robot has one of 1 s: what the default is, does not matter."""
    monkeypatch.setattr(live_repair, "Timing", lambda: Timing(effect_timeout_s=600.0))

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
    assert "not seen within 1 s" in repair["rounds"][0]["reason"]
    assert repair["state"] == "repaired"


STARTS_S = 2.0
"""How long the robot's slow parts take; `effect_timeout_s` is 1 s."""


async def put_model(runtime: Runtime, before: str, after: str) -> None:
    assert before in MODEL
    text = MODEL.replace(before, after)
    await runtime.robots.models.put("small", text, format=None, expected=None, by="test")


async def slow_driver(robot: Robot, name: str, parameter: str) -> int | None:
    """The lidar's driver needs its time until it speaks."""
    robot.do(name, parameter)
    if (name, parameter) == ("start_node", "lidar_node"):
        robot.connected["lidar_node"] = False
        asyncio.get_running_loop().call_later(STARTS_S, robot.do, "start_node", "lidar_node")
    return 0


async def test_a_node_has_the_time_that_the_model_says_it_needs(tmp_path: Path) -> None:
    async with service(tmp_path) as runtime:
        await put_model(runtime, "publishes: {scan: []}", "publishes: {scan: []}, start_s: 2")
        async with robot_on(runtime) as robot:
            robot.spoil = slow_driver
            await robot.settled()
            robot.running["lidar_node"] = robot.connected["lidar_node"] = False
            repair = await the_repair(runtime)
    assert (repair["state"], robot.done) == ("repaired", ["start_node(lidar_node)"])


async def test_a_node_has_the_time_that_it_took_at_the_robots_boot(tmp_path: Path) -> None:
    async with service(tmp_path) as runtime, robot_on(runtime, policy="observe") as robot:
        robot.spoil = slow_driver
        robot.running["lidar_node"] = robot.connected["lidar_node"] = False
        await robot.settled()
        robot.running["lidar_node"] = True
        await robot.settled()
        await asyncio.sleep(STARTS_S)  # a boot takes its time
        robot.do("start_node", "lidar_node")
        await robot.settled()
        etag = (await runtime.robots.memory.robot("r1")).stored.etag
        await runtime.robots.put_robot("r1", CONFIG, expected=etag, by="ann")
        robot.running["lidar_node"] = robot.connected["lidar_node"] = False
        repair = await the_repair(runtime)
        findings = await runtime.repairs.findings("r1")
    assert (repair["state"], robot.done) == ("repaired", ["start_node(lidar_node)"])
    assert [one for one in findings if "lidar_node" in one and "start_s" in one]


async def test_a_driver_is_started_after_its_device_has_booted(tmp_path: Path) -> None:
    """Started sooner it stays mute."""
    booted = asyncio.Event()

    async def boots(robot: Robot, name: str, parameter: str) -> int | None:
        robot.do(name, parameter)
        if name == "power_up":
            asyncio.get_running_loop().call_later(STARTS_S, booted.set)
        robot.connected["base_node"] &= booted.is_set()
        return 0

    async with service(tmp_path) as runtime:
        await put_model(runtime, "base: {channel: 7}", "base: {channel: 7, boot_s: 2}")
        async with robot_on(runtime) as robot:
            robot.spoil = boots
            await robot.settled()
            robot.cut("base")
            repair = await the_repair(runtime)
    assert (repair["state"], robot.done) == ("repaired", SHUT_DOWN)
    assert [wait["names"] for wait in repair["waits"] if "base has booted" in wait["why"]] == [["base"]]
