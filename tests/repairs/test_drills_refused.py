"""Drills that are refused on a robot in memory: it is in use, or nobody would notice anything."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from tests.repairs.robot import CONFIG, Robot, robot_of, the_repair

from robomend.api.runtime import Runtime
from robomend.errors import InputError, NotFound, StateConflict

pytestmark = pytest.mark.anyio


async def drill(runtime: Runtime, fault: str = "node-killed", **changes: Any) -> Any:
    asked = {"component": "mapping", "topic": None, "by": "ann", "reason": "", **changes}
    return await runtime.drills.create("r1", fault=fault, bound_s=5.0, detect_s=2.0, **asked)


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
