"""Drills on a robot in memory: where one is refused, and what ends one."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from tests.repairs.robot import CONFIG, Robot, robot_of, the_repair

from robomend.api.runtime import Runtime
from robomend.errors import InputError, NotFound, StateConflict
from robomend.robots.batches import Batch
from robomend.robots.clock import CLOCK

pytestmark = pytest.mark.anyio


async def drill(runtime: Runtime, fault: str = "node-killed", **changes: Any) -> Any:
    asked = {"component": "mapping", "topic": None, "by": "ann", "reason": "", "bound_s": 5.0, **changes}
    return await runtime.drills.create("r1", fault=fault, detect_s=1.0, **asked)


async def test_a_robot_that_looks_healthy_while_its_repair_is_open_is_in_use(tmp_path: Path) -> None:
    there, release = asyncio.Event(), asyncio.Event()

    async def answers_late(robot: Robot, name: str, parameter: str) -> int | None:
        robot.do(name, parameter)
        there.set()
        await release.wait()
        return 0

    patient = {name: {**how, "timeout_s": 100.0} for name, how in CONFIG["actions"].items()}
    async with robot_of(tmp_path, actions=patient) as (runtime, robot):
        robot.spoil = answers_late
        robot.running["mapping"] = False
        async with asyncio.timeout(60):
            await there.wait()
            while True:
                with pytest.raises(StateConflict) as refused:
                    await drill(runtime)
                if "in use" in str(refused.value):
                    break
                assert "so that a fault would not be seen for itself" in str(refused.value)
                await asyncio.sleep(0.05)
        assert "repair r-" in str(refused.value)
        release.set()
        assert (await the_repair(runtime))["state"] == "repaired"
        assert await runtime.drills.drills("r1", before=None, limit=5) == []


async def test_a_fault_that_the_robot_does_not_have_is_not_found(tmp_path: Path) -> None:
    async with robot_of(tmp_path) as (runtime, _):
        for fault, changes in (
            ("node-killed", {"component": "base"}),
            ("node-killed", {"topic": "map"}),
            ("topic-dropped", {}),
            ("topic-dropped", {"topic": "scan"}),  # another node's
            ("channel-short", {"component": "base"}),  # no emulated board
            ("board-mute", {"component": None}),
        ):
            with pytest.raises(NotFound, match="has no fault"):
                await drill(runtime, fault, **changes)
        with pytest.raises(InputError, match="there are node-killed"):
            await drill(runtime, "node-bored")


class Starved(Robot):
    """Its agent reports topics with a lifetime; while it is starved, it says nothing of them."""

    starved = False

    async def report(self) -> None:
        said = [one for one in self.sentences() if not (self.starved and "ok(" in one)]
        about: dict[str, Any] = {"lifetime_s": 30.0, "time_ns": CLOCK.now_ns()}
        await self.robots.observe(self.id, Batch(tuple(said), source="test robot", **about))


async def test_what_was_heard_before_the_undo_does_not_end_a_drill(tmp_path: Path) -> None:
    async def spoilt(robot: Starved, name: str, parameter: str) -> int | None:
        robot.starved = robot.starved or name == "plant_fault"
        robot.do(name, parameter)
        robot.connected["lidar_node"] = False  # the undo starts it, and it is mute
        return 0

    async with robot_of(tmp_path, Starved, policy="approve", observed_timeout_s=60.0) as (runtime, robot):
        robot.spoil = spoilt
        await drill(runtime, component="lidar_node", bound_s=1.0)

        async def now() -> Any:
            [one] = await runtime.drills.drills("r1", before=None, limit=5)
            return one

        async with asyncio.timeout(60):
            while (await now())["state"] != "recovering":
                await asyncio.sleep(0.05)
            await asyncio.sleep(3)  # longer than any other drill on this robot takes to end
            assert "ok(scan)" in map(str, (await runtime.robots.diagnosed("r1")).literals())
            assert (await now())["state"] == "recovering"
            robot.starved = False
            await robot.settled()
            assert "not ok(scan)" in map(str, (await runtime.robots.diagnosed("r1")).literals())
            robot.connected["lidar_node"] = True
            while (await now())["finished_ns"] is None:
                await asyncio.sleep(0.05)
        ended = await now()
        assert (ended["state"], ended["undone"]) == ("done", True)
        assert ended["reason"] == "undone, and the robot is healthy"
