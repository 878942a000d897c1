"""No act without need: what a symptom says, what is good by now, what is still there, what is stopped."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from tests.repairs.robot import HARDWARE, Robot, put_robot, robot_of, robot_on, running, service, the_repair

from robomend.api.runtime import Runtime
from robomend.planning.choice import Choice
from robomend.repairs.acts import MOST
from robomend.repairs.live_repair import LiveRepair
from robomend.store import attempts
from robomend_client.actions import FAILED
from robomend_client.readings import Symptom

pytestmark = pytest.mark.anyio


@pytest.mark.parametrize("symptom", [Symptom.FAST, Symptom.PUBLISHERS])
async def test_a_second_publisher_is_looked_for_and_no_power_is_cut(tmp_path: Path, symptom: Symptom) -> None:
    """Where nobody knows who publishes what is too fast, its own publisher is restarted, once."""
    async with robot_of(tmp_path) as (runtime, robot):
        robot.kinds["ok(odom)"] = symptom
        robot.broken_topics.add("odom")
        repair = await the_repair(runtime)
    assert repair["state"] == "escalated"
    assert repair["reason"].startswith(
        "probably a second publisher: look who publishes odom; a person is needed; "
    )
    once = ["stop_node(base_node)", "start_node(base_node)"]
    expected = {Symptom.FAST: once, Symptom.PUBLISHERS: []}
    assert robot.done == expected[symptom]


@dataclass
class Deaf(Robot):
    """Its mapping is halted: nothing runs by what is observed, and to start it finds it there."""

    halted: bool = True

    def sentences(self) -> list[str]:
        gone = {"running(mapping)", "ok(map)"} if self.halted else set()
        return [f"not {one}" if one in gone else one for one in super().sentences()]

    def do(self, name: str, parameter: str) -> None:
        if parameter == "mapping":
            if name == "stop_node":
                self.halted = False
            elif self.halted:
                self.message = "runs already: process 4711"
                return
        self.message = ""
        super().do(name, parameter)


@pytest.mark.parametrize("symptom", [None, Symptom.HALTED], ids=str)
async def test_what_a_start_finds_there_is_stopped_first(tmp_path: Path, symptom: Symptom | None) -> None:
    """A kind that does not say that the process has ended plans so at once."""
    async with service(tmp_path) as runtime:
        await put_robot(runtime)
        kinds = {} if symptom is None else {"running(mapping)": symptom}
        robot = Deaf(runtime.repairs, runtime.robots, kinds=kinds)
        async with running(robot):
            repair = await the_repair(runtime)
        tried = await runtime.store.read(attempts.tried, "r1")
    assert repair["state"] == "repaired", repair["reason"]
    known = symptom is Symptom.HALTED
    first = [] if known else ["start_node(mapping)"]
    assert robot.done == [*first, "stop_node(mapping)", "start_node(mapping)"]
    if not known:
        reason = repair["rounds"][0]["reason"]
        assert reason.startswith("start_node(mapping) answered 'runs already', but running(mapping) ")
    assert [one.helped for one in tried] == [True]  # the start was no attempt


@dataclass
class Cured(Robot):
    """A restart of its lidar's driver is all that it needs."""

    def do(self, name: str, parameter: str) -> None:
        super().do(name, parameter)
        if (name, parameter) == ("start_node", "lidar_node"):
            self.broken_topics.clear()


async def test_what_slower_observers_explain_before_the_first_act_is_not_touched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The map is heard to fail first; that its input does is said between the choice and its first act."""
    approved = LiveRepair.approved
    late: list[str] = ["scan"]
    async with service(tmp_path) as runtime, robot_on(runtime, Cured) as robot:

        async def and_then_heard(repair: LiveRepair, choice: Choice) -> bool:
            yes = await approved(repair, choice)
            if late:
                robot.broken_topics.add(late.pop())
                await robot.settled()
            return yes

        monkeypatch.setattr(LiveRepair, "approved", and_then_heard)
        await robot.settled()
        robot.broken_topics.add("map")
        await robot.report()
        repair = await the_repair(runtime)
    assert repair["state"] == "repaired", repair["reason"]
    assert robot.done == ["stop_node(lidar_node)", "start_node(lidar_node)"]
    first = repair["rounds"][0]
    assert (first["ending"], first["reason"]) == (
        "mismatch",
        "stop_node(mapping): lidar or lidar_node is blamed by now, and not mapping",
    )
    assert not first["helped"]
    assert all(step.get("sent_ns") is None for step in first["plan"])


@dataclass
class Reconnecting(Robot):
    """Its drivers find their devices again by themselves, as soon as those have power."""

    def do(self, name: str, parameter: str) -> None:
        super().do(name, parameter)
        if name == "power_up":
            self.connected[HARDWARE[parameter]] = self.running[HARDWARE[parameter]]


async def lose_power(runtime: Runtime, robot: Robot, before: str = "") -> dict[str, Any]:
    """The base loses its power; return its repair."""
    await robot.settled()
    robot.cut("base")
    await robot.report()
    return await the_repair(runtime, after=before)


async def test_a_driver_that_is_good_again_is_not_restarted_and_the_next_time_that_is_not_planned(
    tmp_path: Path,
) -> None:
    async with service(tmp_path) as runtime, robot_on(runtime, Reconnecting) as robot:
        first = await lose_power(runtime, robot)
        assert first["state"] == "repaired"
        assert robot.done == ["power_up(base)"]
        steps = {step["text"]: step for step in first["rounds"][0]["plan"]}
        assert steps["stop_node(base_node)"]["state"] == "already-there"
        assert steps["stop_node(base_node)"]["message"] == "ok(odom) by now: base_node is not touched"
        assert steps["start_node(base_node)"]["state"] == "already-there"
        again = await lose_power(runtime, robot, first["id"])
        assert again["state"] == "repaired"
        assert [step["text"] for step in again["plan"]] == ["power_up(base)"]
    assert robot.done == ["power_up(base)", "power_up(base)"]


TIED = """
robomend: 1
name: tied
nodes:
  skill: {publishes: {grip: []}}
  watch: {publishes: {seen: [grip]}, tied_to: [skill]}
"""


@dataclass
class Skilled(Robot):
    """A skill, and a watch that is tied to it."""

    def facts(self) -> dict[str, bool]:
        facts = {f"running({name})": self.running[name] for name in ("skill", "watch")}
        return facts | {"ok(grip)": self.running["skill"], "ok(seen)": all(facts.values())}


async def test_a_repair_that_gives_up_starts_again_what_it_stopped(tmp_path: Path) -> None:
    """The watch does not start as often as a repair tries; once more, before a person is asked, it does."""

    async def spoil(robot: Robot, name: str, parameter: str) -> int | None:
        times = robot.done.count("start_node(watch)")
        return FAILED if (name, parameter) == ("start_node", "watch") and times < MOST else None

    runs = {"skill": True, "watch": True}
    kind = partial(Skilled, running=runs, connected={}, spoil=spoil)
    async with robot_of(tmp_path, kind, TIED) as (runtime, robot):
        robot.running["skill"] = False
        repair = await the_repair(runtime)
    assert repair["state"] == "escalated"
    assert "stop_node(watch)" in robot.done
    assert robot.running["watch"]
    assert repair["left_off"] == []
    assert "left stopped" not in repair["reason"]
    assert repair["rounds"][-1]["why"] == (
        "what was stopped or switched off for the repair is brought back before it gives up"
    )
