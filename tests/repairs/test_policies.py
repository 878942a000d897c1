"""What a policy lets happen: who is asked, what is allowed, when a repair begins by itself."""

from __future__ import annotations

import asyncio
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from tests.repairs.robot import (
    CONFIG,
    SHUT_DOWN,
    Robot,
    nothing_begins,
    put_robot,
    repaired,
    robot_of,
    service,
    the_repair,
)

from robomend.api.runtime import Runtime
from robomend.errors import Refused, StateConflict
from robomend.robots.batches import Batch

pytestmark = pytest.mark.anyio


async def test_an_approval_counts_once_and_not_after_the_end(tmp_path: Path) -> None:
    async with robot_of(tmp_path, policy="approve") as (runtime, robot):
        robot.cut("base")
        proposed = await the_repair(runtime, ended=False)
        await runtime.repairs.approve(proposed["id"], by="ann", reason="")
        with pytest.raises(StateConflict):
            await runtime.repairs.approve(proposed["id"], by="bob", reason="")
        await the_repair(runtime)
        with pytest.raises(StateConflict, match="has ended already"):
            await runtime.repairs.approve(proposed["id"], by="bob", reason="")
    assert robot.done == SHUT_DOWN


async def test_a_plan_that_waits_is_withdrawn_when_the_diagnosis_changes(tmp_path: Path) -> None:
    async with robot_of(tmp_path, policy="approve") as (runtime, robot):
        robot.cut("base")
        proposed = await the_repair(runtime, ended=False)
        robot.do("power_up", "base")
        robot.do("start_node", "base_node")
        repair = await the_repair(runtime)
    assert repair["id"] == proposed["id"]
    assert (repair["state"], repair["reason"]) == (
        "cancelled",
        "the robot is healthy again: the plan no longer applies",
    )
    assert robot.done == []


async def test_a_robot_of_which_only_a_part_is_known_is_not_called_healthy_again(tmp_path: Path) -> None:
    async with robot_of(tmp_path, policy="approve") as (runtime, robot):
        robot.cut("base")
        await the_repair(runtime, ended=False)
        robot.silent = True
        gone = ["on(base)", "running(base_node)", "ok(odom)"]
        for source in {entry.source for entry in (await runtime.robots.diagnosed("r1")).sight.entries()}:
            await runtime.robots.observe("r1", Batch([], source=source, unknown=gone))
        repair = await the_repair(runtime)
    assert repair["state"] == "cancelled"
    assert repair["reason"].startswith("not confirmed: nobody reports ok(odom), on(base)")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"protected": ["base", "base_node"]}, "base is protected"),
        # The driver must be stopped and started: two actions on it.
        (
            {"limits": {"attempts_per_hour": 1, "rounds": 6}},
            "more than 1 actions on base_node within an hour, the limit",
        ),
        (
            {"allow": ["start_node", "stop_node"]},
            "power_up(base): 'power_up' is not on the robot's allow-list (start_node, stop_node)",
        ),
    ],
    ids=["protected", "the limit", "the allow-list"],
)
async def test_what_policy_forbids_is_not_begun_and_said_so(
    tmp_path: Path, changes: dict[str, Any], said: str
) -> None:
    protected = "protected" in changes
    repair, robot = await repaired(
        tmp_path,
        lambda robot: robot.broken_topics.add("odom") if protected else robot.cut("base"),
        **changes,
    )
    assert repair["state"] == "escalated"
    assert said in repair["reason"]
    assert robot.done == []


async def test_under_observe_nothing_is_ever_done(tmp_path: Path) -> None:
    async with robot_of(tmp_path, policy="observe") as (runtime, robot):
        robot.cut("base")
        await nothing_begins(runtime, 0.7)
        with pytest.raises(Refused, match="observe"):
            await runtime.repairs.create("r1", bad=None, by="bob", reason="")
        would = await runtime.repairs.plan("r1", bad=None, planner=None, timeout_s=5.0, pddl=True)
    assert [step["text"] for step in would["plan"]["steps"]] == SHUT_DOWN
    assert would["plan"]["graph"]["nodes"] == SHUT_DOWN  # the form of POST /plans and `robomend plan`
    assert would["choice"]["bad"] == would["alternatives"][0]["bad"] == ["base"]
    assert robot.done == []


async def test_one_action_that_needs_a_yes_makes_the_whole_plan_wait(tmp_path: Path) -> None:
    actions = {**CONFIG["actions"], "power_up": {**CONFIG["actions"]["power_up"], "policy": "approve"}}
    async with robot_of(tmp_path, actions=actions) as (runtime, robot):
        robot.running["mapping"] = False
        assert (await the_repair(runtime))["state"] == "repaired"
        robot.cut("base")
        proposed = await the_repair(runtime, ended=False)
        assert robot.done == ["start_node(mapping)"]
        await runtime.repairs.cancel(proposed["id"], by="ann", reason="not now")


async def test_outside_the_maintenance_windows_nothing_begins_by_itself(tmp_path: Path) -> None:
    now = datetime.now(UTC)
    closed = {"weekdays": [(now.weekday() + 3) % 7], "start": "00:00", "end": "23:59"}
    async with robot_of(tmp_path, windows=[closed]) as (runtime, robot):
        robot.cut("base")
        await nothing_begins(runtime, 0.7)
        await runtime.repairs.create("r1", bad=None, by="ann", reason="I am here")
        repair = await the_repair(runtime)
    assert repair["state"] == "repaired"


async def test_a_diagnosis_that_does_not_hold_begins_no_repair(tmp_path: Path) -> None:
    async with robot_of(tmp_path, hold_s=1.0) as (runtime, robot):
        robot.running["mapping"] = False
        await robot.settled()
        robot.running["mapping"] = True
        await nothing_begins(runtime, 1.2)
        robot.running["mapping"] = False
        repair = await the_repair(runtime)
    assert repair["state"] == "repaired"


async def test_under_approve_nothing_is_asked_that_would_be_withdrawn_within_its_own_settling_time(
    tmp_path: Path,
) -> None:
    async def declares(runtime: Runtime, settling_s: float) -> None:
        """The agent says how long its observer may need until it takes a verdict back."""
        observes = {"ok(map)": (0.1, settling_s)}
        await runtime.repairs.orders(
            "r1", host=None, wait_s=0.0, agent="observer", can=[], observes=observes, settled=None
        )

    async def diagnosed(runtime: Runtime, *, healthy: bool) -> None:
        async with asyncio.timeout(60):
            while True:
                current = (await runtime.robots.diagnosed("r1")).current
                if current is not None and current.healthy is healthy:
                    return
                await asyncio.sleep(0.02)

    async with robot_of(tmp_path, policy="approve") as (runtime, robot):
        await declares(runtime, settling_s=120.0)
        robot.broken_topics.add("map")
        await diagnosed(runtime, healthy=False)
        robot.broken_topics.clear()
        await diagnosed(runtime, healthy=True)
        assert list(await runtime.repairs.repairs("r1", before=None, limit=1)) == []
        await declares(runtime, settling_s=0.1)
        robot.broken_topics.add("map")
        asked = await the_repair(runtime, ended=False)
    assert [step["text"] for step in asked["plan"]] == ["stop_node(mapping)", "start_node(mapping)"]


async def test_a_flicker_withdraws_no_plan_that_waits_for_a_yes(tmp_path: Path) -> None:
    async with robot_of(tmp_path, policy="approve") as (runtime, robot):
        observes = {"ok(map)": (0.1, 2.0)}  # so long its observer may need to see it fail again
        await runtime.repairs.orders(
            "r1", host=None, wait_s=0.0, agent="observer", can=[], observes=observes, settled=None
        )
        robot.broken_topics.add("map")
        asked = await the_repair(runtime, ended=False)
        for _ in range(3):
            robot.broken_topics.clear()
            await robot.settled()
            robot.broken_topics.add("map")
            await robot.settled()
        robot.spoil = mends_the_map
        await runtime.repairs.approve(asked["id"], by="ann", reason="")
        repair = await the_repair(runtime)
    assert (repair["id"], repair["state"]) == (asked["id"], "repaired")


async def mends_the_map(robot: Robot, name: str, parameter: str) -> int | None:
    robot.broken_topics.clear()
    return None


async def test_after_the_policy_became_observe_the_running_repair_does_nothing_more(tmp_path: Path) -> None:
    begun, forbidden = asyncio.Event(), asyncio.Event()

    async def slow(robot: Robot, name: str, parameter: str) -> int | None:
        begun.set()
        await forbidden.wait()
        return None

    patient = {name: {**action, "timeout_s": 60.0} for name, action in CONFIG["actions"].items()}
    async with robot_of(tmp_path, actions=patient) as (runtime, robot):
        robot.spoil = slow
        robot.cut("base")
        await begun.wait()
        etag = (await runtime.robots.memory.robot("r1")).stored.etag
        watched = {**CONFIG, "actions": patient, "policy": "observe"}
        await runtime.robots.put_robot("r1", watched, expected=etag, by="ann")
        forbidden.set()
        repair = await the_repair(runtime)
    assert repair["state"] == "escalated"
    assert "the policy for 'stop_node' is 'observe'" in repair["reason"]
    assert robot.done == ["power_up(base)"]


TIED = """
robomend: 1
name: tied
nodes:
  moveit: {publishes: {plan: []}}
  traj_ctl: {publishes: {cmd: [plan]}, tied_to: [moveit], protected: true}
"""


async def test_a_node_is_not_restarted_if_a_protected_one_would_have_to_restart_after_it(
    tmp_path: Path,
) -> None:
    seen = ("running(moveit)", "running(traj_ctl)", "not ok(plan)")
    async with service(tmp_path) as runtime:
        config = {**CONFIG, "model": "tied", "observed": [*seen[:2], "ok(plan)"]}
        await put_robot(runtime, TIED, **config)
        await runtime.robots.observe("r1", Batch(seen, source="test"))
        repair = await the_repair(runtime)
        assert await runtime.repairs.orders("r1", host=None, wait_s=0.0) is None
    assert repair["state"] == "escalated"
    assert "stop_node(moveit) is refused: traj_ctl, tied to it, is protected" in repair["reason"]
    assert repair["plan"] == []
