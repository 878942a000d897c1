"""The reason of a repair that has ended never contradicts its record, nor what was observed."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Awaitable, Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from tests.repairs.robot import (
    BOOTS_AT_ONCE,
    CONFIG,
    HARDWARE,
    NODES,
    Robot,
    repaired,
    running,
    service,
    the_repair,
)

from robomend.api.runtime import Runtime
from robomend.store import observations
from robomend.store.records import Paging
from robomend_bench.faults.trial import contradictions
from robomend_client.actions import FAILED, NO_PROGRAM, REFUSED

pytestmark = pytest.mark.anyio

ROBOTS = 12
"""Each with a fault of its own, side by side; the seed is the number of the robot."""

QUICK: dict[str, Any] = {
    **CONFIG,
    "observed_timeout_s": 1.0,
    "limits": {"attempts_per_hour": 100, "rounds": 3},
    "actions": {
        name: {**config, "effect_timeout_s": 0.4, "retries": 1} for name, config in CONFIG["actions"].items()
    },
}


async def test_a_driver_that_ends_again_after_each_start_is_said_to(tmp_path: Path) -> None:
    async def starts(robot: Robot, name: str, parameter: str) -> int | None:
        if name == "start_node":
            robot.running[parameter] = True
            await robot.report()
            robot.running[parameter] = False
        return 0

    found, _ = await repaired(tmp_path, lambda robot: robot.do("stop_node", "mapping"), spoil=starts, **QUICK)
    assert found["state"] == "escalated"
    assert found["reason"].startswith("mapping ended again after its start (3 times)")


def breaks(robot: Robot, chance: random.Random) -> None:
    """Something of the robot breaks."""
    for _ in range(chance.choice((1, 1, 2))):
        match chance.choice(("cut", "end", "lose", "silence")):
            case "cut":
                robot.cut(chance.choice(list(HARDWARE)))
            case "end":
                robot.do("stop_node", chance.choice(NODES))
            case "lose":
                robot.connected[chance.choice(list(HARDWARE.values()))] = False
            case "silence":
                robot.broken_topics.add(chance.choice(("odom", "scan", "map")))


def spoils(chance: random.Random) -> Callable[[Robot, str, str], Awaitable[int | None]]:
    """Return what becomes of acts: done, refused, failed, without effect, healing it, or unheard."""

    async def spoiled(robot: Robot, name: str, parameter: str) -> int | None:
        match chance.choice(("", "", "", "", "refused", "failed", "gone", "idle", "mute", "heals", "deaf")):
            case "refused":
                return REFUSED
            case "failed":
                return FAILED
            case "gone":
                return NO_PROGRAM if name == "start_node" else None
            case "idle":
                return 0
            case "mute" if name == "start_node":
                robot.running[parameter] = True
                return 0
            case "heals":
                robot.broken_topics.clear()
            case "deaf":
                robot.silent = True
        return None

    return spoiled


async def observed(runtime: Runtime, robot: str, until_ns: int) -> set[str]:
    """Return what OBS held at a time, by the history."""
    page = await runtime.store.read(partial(_history, robot))
    held: dict[str, str] = {}
    for batch in reversed(page):
        if batch.time_ns <= until_ns:
            held |= {str(entry.atom): str(entry.literal) for entry in batch.entries}
    return set(held.values())


def _history(robot: str, view: Any) -> list[Any]:
    return list(observations.history(view, robot, Paging(limit=1000)).items)


async def test_what_a_reason_says_is_in_the_record_whatever_becomes_of_the_acts(tmp_path: Path) -> None:
    async def trial(runtime: Runtime, number: int) -> tuple[str, list[str]]:
        robot, chance = Robot(runtime.repairs, runtime.robots, id=f"r{number}"), random.Random(number)
        await runtime.robots.put_robot(robot.id, QUICK, expected=None, by="test")
        async with running(robot):
            await robot.settled()
            robot.spoil = spoils(chance)
            breaks(robot, chance)
            ended = await the_repair(runtime, robot.id)
        repair = await runtime.repairs.repair(ended["id"])
        literals = await observed(runtime, robot.id, repair["finished_ns"])
        return repair["state"], [f"{robot.id}: {why}" for why in contradictions(repair, literals)]

    async with service(tmp_path) as runtime:
        await runtime.robots.models.put("small", BOOTS_AT_ONCE, format=None, expected=None, by="test")
        trials = await asyncio.gather(*(trial(runtime, number) for number in range(ROBOTS)))
    assert [why for _, found in trials for why in found] == []
    assert {state for state, _ in trials} >= {"repaired", "escalated"}


STEP = {
    "index": 0,
    "id": "r-1:0",
    "text": "start_node(a)",
    "state": "done",
    "result": 0,
    "seen": ["ok(x)"],
    "missing": [],
    "sent_ns": 1,
    "ended_ns": 2,
}
ROUND = {"plan": [STEP], "ending": "done", "reason": "every effect was seen", "helped": True}
WELL = "every observation is what a healthy robot would show"
REPAIR = {"state": "repaired", "reason": WELL, "rounds": [ROUND], "left_off": []}
LACKING = {**STEP, "state": "failed", "seen": [], "missing": ["ok(x)"]}


def with_step(ending: str, **changes: Any) -> dict[str, Any]:
    return {"rounds": [{**ROUND, "ending": ending, "plan": [{**STEP, **changes}]}]}


def escalated(reason: str, **changes: Any) -> dict[str, Any]:
    return {"state": "escalated", "reason": reason, **changes}


@pytest.mark.parametrize(
    ("changes", "literals", "said"),
    [
        ({}, {"ok(x)"}, []),
        ({}, {"not ok(x)"}, ["OBS has not ok(x)"]),
        ({"reason": "no component is blamed any more; not ok(x): still seen"}, {"not ok(x)"}, []),
        ({"reason": ""}, (), ["for no reason"]),
        (escalated(WELL), (), [f"escalated, and {WELL}"]),
        (escalated("stuck; left off: lidar"), (), ["lidar is left off in the reason"]),
        (escalated("stuck; left off: lidar", left_off=["lidar"]), (), []),
        (escalated("start_node(a): it was done 3 times in this repair"), (), ["1 times in the record"]),
        (escalated("start_node(a): it was done 1 times in this repair"), (), []),
        (escalated("start_node(a) answered 'done', but ok(x) was not seen"), (), ["of which ok(x) was not"]),
        (
            escalated(
                "start_node(a) answered 'done', but ok(x) was not seen",
                rounds=[{**ROUND, "ending": "effect-missing", "plan": [LACKING]}],
            ),
            (),
            [],
        ),
        (with_step("done", state="failed"), (), ["is done, but not start_node(a)"]),
        (with_step("effect-missing"), (), ["an effect was missing, and none is"]),
        (with_step("action-failed"), (), ["an action failed, and none did"]),
        (with_step("halted"), (), ["its last round was halted"]),
        (with_step("done", ended_ns=1, sent_ns=2), (), ["ended before it was sent"]),
        (with_step("done", missing=["ok(x)"]), (), ["is done, but not", "was seen and was missing"]),
        (with_step("done", result=1, seen=[]), (), ["its action ended with 1"]),
        (with_step("mismatch", state="running"), (), ["a step is under way"]),
        ({"rounds": [{**ROUND, "ending": None}]}, (), ["has no end"]),
    ],
)
def test_a_contradiction_is_found(changes: dict[str, Any], literals: set[str], said: list[str]) -> None:
    found = contradictions({**REPAIR, **changes}, literals)
    assert len(found) == len(said), found
    for why, part in zip(found, said, strict=True):
        assert part in why
