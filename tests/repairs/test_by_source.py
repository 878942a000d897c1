"""One computer of a robot hears a topic, another does not: nothing is done about that by itself."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.repairs.robot import Robot, nothing_begins, robot_on, service
from tests.waiting import eventually

from robomend.repairs import calm
from robomend.robots.batches import Batch
from robomend.robots.clock import CLOCK
from robomend.robots.health import HealthState, health_of
from robomend_client.readings import Reading, Symptom

pytestmark = pytest.mark.anyio

DEAF = Reading("0 of 10 Hz for 2.1 s", symptom=Symptom.SILENT)
HEARD = Reading(10.0, "Hz")
LIFETIME_S = 2.0


class TwoComputers(Robot):
    """The second computer hears the scan, too, until something between the two breaks."""

    deaf_ns: int | None = None

    async def report(self) -> None:
        now_ns = CLOCK.now_ns()
        sentences = self.sentences()
        readings = [HEARD if one == "ok(scan)" else None for one in sentences]
        since = [now_ns] * len(sentences)
        lives = LIFETIME_S
        first = Batch(sentences, source="pc1", time_ns=now_ns, since=since, lifetime_s=lives)
        await self.robots.observe("r1", replace(first, readings=readings))
        deaf = self.deaf_ns is not None or "not ok(scan)" in sentences
        second = Batch(
            ["not ok(scan)" if deaf else "ok(scan)"],
            source="pc2",
            time_ns=now_ns,
            since=[now_ns],
            onset=[None if self.deaf_ns is None else min(self.deaf_ns, now_ns)],
            lifetime_s=lives,
            readings=[DEAF if deaf else HEARD],
        )
        await self.robots.observe("r1", second)


async def contradicting(runtime: Any, robot: TwoComputers) -> list[str]:
    """Break what is between the computers; return what the service finds once it has noticed."""
    await robot.settled()
    robot.deaf_ns = CLOCK.now_ns()
    async with asyncio.timeout(60):
        while True:
            found = [one for one in await runtime.repairs.findings("r1") if "contradict" in one]
            if found:
                return found
            await asyncio.sleep(0.02)


async def test_nothing_is_done_about_what_two_computers_contradict_each_other_about(tmp_path: Path) -> None:
    async with service(tmp_path) as runtime, robot_on(runtime, TwoComputers) as robot:
        [found] = await contradicting(runtime, robot)
        assert found == (
            "sources contradict each other about ok(scan): pc1 reports ok(scan) (10 Hz), pc2 reports not "
            "ok(scan) (0 of 10 Hz for 2.1 s); seen from pc1, not from pc2: look at what is between them; "
            "it is unknown: `believe` or `bad_wins` of the robot says who counts"
        )
        await nothing_begins(runtime, 2.0)
        state = await runtime.robots.diagnosed("r1")
        how, unknown = health_of(state)
        assert (how, [str(atom) for atom in unknown]) == (HealthState.PARTLY_UNKNOWN, ["ok(scan)"])
        robot.deaf_ns = None
        async with asyncio.timeout(60):
            while await runtime.repairs.findings("r1"):
                await asyncio.sleep(0.02)
    assert robot.done == []


async def test_where_the_deaf_one_is_believed_its_word_is_acted_upon(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(calm, "MOST_S", 1.0)
    async with service(tmp_path) as runtime, robot_on(runtime, TwoComputers, believe=["pc2"]) as robot:
        [found] = await contradicting(runtime, robot)
        assert "; pc2 is believed" in found
        await eventually(lambda: robot.done, "it is acted upon")
        [repair] = await runtime.repairs.repairs("r1", before=None, limit=1)
    assert repair["rounds"][0]["symptoms"][0]["literal"] == "not ok(scan)"
