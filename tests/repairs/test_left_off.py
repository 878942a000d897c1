"""What a repair switched off and did not bring back: brought back by the next plan, or named."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from pathlib import Path

import pytest
from tests.repairs.robot import (
    CONFIG,
    MODEL,
    Robot,
    answers,
    put_robot,
    repaired,
    running,
    service,
    the_repair,
)
from tests.waiting import eventually, for_ever

from robomend.store import attempts
from robomend.store.records import Quarantine
from robomend_client.actions import FAILED

pytestmark = pytest.mark.anyio


async def test_a_device_that_does_not_come_back_is_named_in_the_end(tmp_path: Path) -> None:
    repair, robot = await repaired(
        tmp_path, lambda robot: robot.broken_topics.add("odom"), spoil=answers(FAILED, "power_up")
    )
    assert "shutdown(base)" in robot.done
    assert repair["state"] == "escalated"
    assert "; left off: base" in repair["reason"]
    assert repair["left_off"] == ["base"]


@dataclass
class Unseen(Robot):
    """Nobody observes whether its devices have power."""

    def sentences(self) -> list[str]:
        return [sentence for sentence in super().sentences() if "on(" not in sentence]


UNSEEN = {**CONFIG, "model": "unseen", "observed": [one for one in CONFIG["observed"] if "on(" not in one]}


async def test_after_a_cut_off_and_a_restart_the_next_plan_brings_back_what_nobody_sees_is_off(
    tmp_path: Path,
) -> None:
    reached = asyncio.Event()

    async def hangs(robot: Robot, name: str, parameter: str) -> int | None:
        if name == "power_up":
            reached.set()
            await for_ever()
        return None

    async with service(tmp_path) as runtime:
        await put_robot(runtime, MODEL, **UNSEEN)
        robot = Unseen(runtime.repairs, runtime.robots, spoil=hangs)
        async with running(robot):
            await robot.settled()
            robot.broken_topics.add("odom")
            async with asyncio.timeout(60):
                await reached.wait()
            cut_off = (await runtime.repairs.repairs("r1", before=None, limit=1))[0]
            await runtime.repairs.cancel(cut_off["id"], by="ann", reason="not now")
            repair = await the_repair(runtime)
        assert (repair["state"], repair["reason"]) == ("cancelled", "not now; left off: base")
        # Even what is left alone for a while is brought back: it is off by our doing.
        aside = Quarantine("r1", "base", "its repairs keep failing", failures=3, since_ns=0, until_ns=None)
        fence = runtime.store.ownership.held["r1"]
        await runtime.store.write(lambda tx: attempts.put_quarantine(tx, aside, fence=fence))
    async with service(tmp_path) as runtime:
        robot = Unseen(runtime.repairs, runtime.robots, on=robot.on, connected=robot.connected)
        async with running(robot):
            await robot.settled()
            assert robot.on["base"] is False
            await runtime.repairs.create("r1", bad=None, by="ann", reason="now")
            await eventually(lambda: robot.on["base"], "the base has power again")
            repair = await the_repair(runtime)
    assert repair["state"] == "repaired"
    assert robot.done[0] == "power_up(base)"
    assert repair["left_off"] == []
