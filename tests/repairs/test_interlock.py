"""`act_when` of the model: nothing is sent to a robot unless OBS shows it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from tests.repairs.robot import CONFIG, MODEL, SHUT_DOWN, Robot, put_robot, running, service, the_repair
from tests.waiting import LOOK_S

from robomend.api.runtime import Runtime

pytestmark = pytest.mark.anyio

PARKED = MODEL + "properties: [parked]\nact_when: ok(parked)\n"


@dataclass
class Driving(Robot):
    """It says whether it is parked; None: it does not."""

    parked: bool | None = False

    def sentences(self) -> list[str]:
        said = [] if self.parked is None else ["ok(parked)" if self.parked else "not ok(parked)"]
        return [*super().sentences(), *said]


@asynccontextmanager
async def driving(runtime: Runtime, *, parked: bool | None) -> AsyncIterator[Driving]:
    await put_robot(runtime, PARKED, model="parked")
    robot = Driving(runtime.repairs, runtime.robots, parked=parked)
    async with running(robot):
        yield robot


@pytest.mark.parametrize(
    ("parked", "said"), [(False, "not ok(parked) is observed"), (None, "nobody reports ok(parked)")]
)
async def test_nothing_is_sent_before_the_robot_is_seen_parked_and_then_it_is_repaired(
    tmp_path: Path, parked: bool | None, said: str
) -> None:
    async with service(tmp_path) as runtime, driving(runtime, parked=parked) as robot:
        await robot.settled()
        robot.cut("base")
        first = await the_repair(runtime)
        assert (first["state"], robot.done) == ("escalated", [])
        why = f"act_when of the model, `ok(parked)`, is not what is observed: {said}"
        assert first["reason"] == f"{why}; suspected: base"
        robot.parked = True
        second = await the_repair(runtime, after=first["id"])
        assert second["state"] == "repaired"
    assert robot.done == SHUT_DOWN


async def test_a_robot_that_drives_off_in_the_middle_of_a_plan_gets_no_further_action(tmp_path: Path) -> None:
    async def drive_off(robot: Robot, name: str, parameter: str) -> int | None:
        assert isinstance(robot, Driving)
        robot.parked = False
        await robot.report()
        return None

    async with service(tmp_path) as runtime, driving(runtime, parked=True) as robot:
        robot.spoil = drive_off
        await robot.settled()
        robot.cut("base")
        repair = await the_repair(runtime)
    assert repair["state"] == "escalated"
    assert repair["reason"].startswith("stop_node(base_node): act_when of the model, `ok(parked)`")
    assert robot.done == SHUT_DOWN[:1]


async def sent(runtime: Runtime) -> bool:
    """Return whether an action of the robot's repair waits for its agent."""
    found = await runtime.repairs.repairs("r1", before=None, limit=1)
    return bool(found) and any(step.get("sent_ns") for step in found[0]["plan"])


async def test_an_action_that_waits_for_its_agent_is_not_handed_out_after_the_robot_drove_off(
    tmp_path: Path,
) -> None:
    async with service(tmp_path) as runtime:
        # It waits for its agent for as long as this test may take.
        patient = {name: {**options, "timeout_s": 120.0} for name, options in CONFIG["actions"].items()}
        config = {**CONFIG, "model": "parked", "actions": patient}
        await put_robot(runtime, PARKED, **config)
        robot = Driving(runtime.repairs, runtime.robots, parked=True)
        robot.cut("base")
        await robot.report()
        async with asyncio.timeout(60):
            while not await sent(runtime):
                await asyncio.sleep(LOOK_S)
        robot.parked = False
        await robot.report()
        assert await runtime.repairs.orders("r1", host=None, wait_s=0.0) is None
        robot.parked = True
        await robot.report()
        async with asyncio.timeout(60):
            while await runtime.repairs.orders("r1", host=None, wait_s=0.0) is None:
                await asyncio.sleep(LOOK_S)
