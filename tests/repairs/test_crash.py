"""kill -9 of the service in the middle of a repair: it goes on where it was, and nothing is done twice.

`--long` kills it at 100 random moments.
"""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.repairs.remote import RemoteRobot, ServiceProcess, awaits, ended, latest, remote_robot, services
from tests.repairs.robot import Robot, with_recalibrate
from tests.waiting import for_ever

pytestmark = pytest.mark.anyio


def is_well(robot: Robot) -> bool:
    return not any(sentence.startswith("not") for sentence in robot.sentences())


async def power_up(robot: RemoteRobot, running: list[ServiceProcess], before: str | None) -> dict[str, Any]:
    """Wait for the end of the repair that comes after `before`."""
    return await latest(running, lambda repair: ended(repair) and repair["id"] != before)


@pytest.mark.timeout(3600)  # the long version
async def test_a_power_up_survives_kill_9_at_random_moments(tmp_path: Path, long: bool) -> None:
    draw = random.Random(time.time_ns())
    interrupted = 0
    limits = {"attempts_per_hour": 1000, "rounds": 6}
    async with (
        services(("--data", str(tmp_path))) as running,
        remote_robot(running, limits=limits) as robot,
    ):
        await robot.settled()
        robot.go_off()
        last = (await power_up(robot, running, None))["id"]
        await robot.rest()
        robot.go_off()
        began = time.monotonic()
        last = (await power_up(robot, running, last))["id"]  # undisturbed, to know how long it takes
        takes_s = time.monotonic() - began
        for round_ in range(100 if long else 4):
            await robot.rest()
            robot.go_off()
            moment_s = draw.uniform(0, min(1.1 * takes_s, 3.0))
            await asyncio.sleep(moment_s)  # a random moment
            await running[0].kill()
            await running[0].start()
            repair = await power_up(robot, running, last)
            last = repair["id"]
            where = f"round {round_}, killed after {moment_s:.3f} s: {repair['state']}, {repair['reason']}"
            assert repair["state"] == "repaired", where
            assert robot.complaints == [], where
            assert is_well(robot), where
            steps = [step for one in repair["rounds"] for step in one["plan"]]
            assert not any(step.get("state") == "running" for step in steps), where
            interrupted += any(one["ending"] == "interrupted" for one in repair["rounds"])
            print(
                f"killed {round_ + 1} times, {interrupted} in the middle of a plan; {len(robot.done)} actions"
            )


@asynccontextmanager
async def recalibrating(folder: Path) -> AsyncIterator[tuple[list[ServiceProcess], RemoteRobot]]:
    """Run a robot that is in the middle of an action that must not be repeated, and will not answer."""
    begun = asyncio.Event()

    async def slow(robot: Robot, name: str, parameter: str) -> int | None:
        begun.set()
        await for_ever()
        return None

    settings = ("--data", str(folder))
    async with services(settings) as running, remote_robot(running, **with_recalibrate()) as robot:
        robot.spoil = slow
        await robot.settled()
        robot.broken_topics.add("odom")
        async with asyncio.timeout(60):
            await begun.wait()
        yield running, robot


async def test_an_unknown_outcome_of_what_must_not_be_repeated_is_a_question(tmp_path: Path) -> None:
    async with recalibrating(tmp_path) as (running, robot):
        await running[0].kill()
        await running[0].start()
        asked = await latest(running, awaits)
        assert "recalibrate(base_node) was under way, which must not be done twice" in asked["reason"]
        # Asked again after another crash: the question is on disk.
        await running[0].kill()
        await running[0].start()
        again = await latest(running, awaits)
        assert (again["id"], again["reason"]) == (asked["id"], asked["reason"])
        robot.spoil = None
        robot.broken_topics.clear()  # a person looked, and it had worked
        await robot.report()
        client = running[0].client
        assert client is not None
        await client.approve(asked["id"], "it did work")
        repair = await latest(running, ended)
    assert (repair["id"], repair["state"]) == (asked["id"], "repaired")
    assert len(robot.ids) == 1


async def test_a_shutdown_in_the_middle_of_such_an_action_asks_as_well(tmp_path: Path) -> None:
    async with recalibrating(tmp_path) as (running, robot):
        await running[0].stop()
        await running[0].start()
        asked = await latest(running, awaits)
        assert "must not be done twice" in asked["reason"]
        client = running[0].client
        assert client is not None
        cancelled = await client.cancel(asked["id"], "no")
    assert (cancelled["state"], cancelled["reason"]) == ("cancelled", "no")
    assert len(robot.ids) == 1


async def test_a_yes_that_was_given_before_the_crash_holds_after_it(tmp_path: Path) -> None:
    async with (
        services(("--data", str(tmp_path))) as running,
        remote_robot(running, policy="approve") as robot,
    ):
        robot.acts_s = (0.4, 0.5)
        await robot.settled()
        robot.go_off()
        asked = await latest(running, awaits)
        client = running[0].client
        assert client is not None
        await client.approve(asked["id"], "go")
        while not robot.ids:
            await asyncio.sleep(0.01)
        await running[0].kill()
        await running[0].start()
        repair = await latest(running, ended)
    assert (repair["id"], repair["state"]) == (asked["id"], "repaired")
    assert robot.complaints == []


async def test_the_global_stop_holds_across_a_crash_and_what_it_ended_begins_anew(tmp_path: Path) -> None:
    begun = asyncio.Event()

    async def slow(robot: Robot, name: str, parameter: str) -> int | None:
        begun.set()
        await asyncio.sleep(0.5)  # an action takes time
        return None

    async with services(("--data", str(tmp_path))) as running, remote_robot(running) as robot:
        robot.spoil = slow
        await robot.settled()
        robot.go_off()
        async with asyncio.timeout(60):
            await begun.wait()
        client = running[0].client
        assert client is not None
        await client.stop("people on the floor")
        async with asyncio.timeout(60):
            while not (await client.stopped())["written"]:  # 202: in force, and not on the disk yet
                await asyncio.sleep(0.02)
        await running[0].kill()
        await asyncio.sleep(0.2)  # what was handed out before the stop may still be on its way to the robot
        begun_before = len(robot.ids)
        await running[0].start()
        stopped = await latest(running, ended)
        await asyncio.sleep(1.0)  # time in which it could act
        assert len(robot.ids) == begun_before
        assert (stopped["state"], stopped["reason"]) == ("cancelled", "global stop: people on the floor")
        client = running[0].client
        assert client is not None
        await client.resume()
        repair = await power_up(robot, running, stopped["id"])
    assert repair["state"] == "repaired"
    assert robot.complaints == []
