"""Acts that undo each other: what one brings back, it takes from another."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from tests.repairs.robot import Robot, robot_of, robot_on, service, the_repair

from robomend.model.loading import load_text
from robomend.planning.advice import parts_of
from robomend.planning.quarantine import undoing
from robomend.planning.tried import S_TO_NS, Attempt
from robomend.repairs.account import account

pytestmark = pytest.mark.anyio

CAMERAS = ("cam_a", "cam_b", "cam_c")


@dataclass
class OneBus(Robot):
    """Cameras of one bus, which the model does not know: whichever starts takes it from the next one."""

    cameras: tuple[str, ...] = CAMERAS[:2]
    ends: bool = False  # the driver that loses it; else it runs on, mute
    after_s: float = 0.0  # it does
    lost: list[str] = field(default_factory=list)
    up: set[str] = field(default_factory=lambda: set(CAMERAS))
    has: set[str] = field(default_factory=lambda: set(CAMERAS))

    def lose(self, camera: str) -> None:
        self.lost.append(camera)
        self.has.discard(camera)
        if self.ends:
            self.up.discard(camera)

    def do(self, name: str, parameter: str) -> None:
        if name == "stop_node":
            self.up.discard(parameter)
            self.has.discard(parameter)
            return
        self.up.add(parameter)
        self.has.add(parameter)
        following = self.cameras[(self.cameras.index(parameter) + 1) % len(self.cameras)]
        asyncio.get_running_loop().call_later(self.after_s, self.lose, following)

    def facts(self) -> dict[str, bool]:
        facts = {f"running({one})": one in self.up for one in self.cameras}
        return facts | {f"ok(img_{one[-1]})": one in self.has for one in self.cameras}


def bus(cameras: Sequence[str] = CAMERAS[:2]) -> str:
    nodes = "".join(f"  {one}: {{publishes: {{img_{one[-1]}: []}}}}\n" for one in cameras)
    return f"robomend: 1\nname: bus\nnodes:\n{nodes}"


@pytest.mark.parametrize(
    ("kind", "told", "starts"),
    [
        ({}, "restarting cam_b breaks cam_a, and the other way round", 3),
        ({"ends": True}, "starting cam_b breaks cam_a, and the other way round", 3),
        # It is seen after the repair has ended well, and needs one of its own: it may be a coincidence.
        ({"after_s": 1.5}, "restarting cam_b breaks cam_a, and the other way round", 5),
        (
            {"cameras": CAMERAS},
            "restarting cam_b breaks cam_c, restarting cam_c breaks cam_a, restarting cam_a breaks cam_b",
            4,
        ),
    ],
    ids=["mute", "ended", "later", "three in a circle"],
)
async def test_repairs_that_undo_each_other_end_as_soon_as_they_begin_anew(
    tmp_path: Path, kind: dict[str, Any], told: str, starts: int
) -> None:
    model = bus(kind.get("cameras", CAMERAS[:2]))
    async with robot_of(tmp_path, partial(OneBus, **kind), model) as (runtime, robot):
        robot.lose("cam_a")
        repair = await the_repair(runtime)
        while repair["state"] == "repaired":
            repair = await the_repair(runtime, after=repair["id"])
    assert repair["state"] == "escalated"
    assert repair["reason"].startswith(f"{told}; ")
    assert len([one for one in robot.done if one.startswith("start_node")]) == starts
    if not robot.after_s:
        assert not any(one["helped"] for one in repair["rounds"])
        undone = next(line for line in account(repair) if "it did not help" in line)
        assert undone.startswith("  it did not help: cam_a is well again, and since it: img_b not ok")


async def test_what_fails_beside_a_repair_and_not_by_it_is_repaired_too(tmp_path: Path) -> None:
    """Two faults in a row, neither by the other's repair, and none of it comes again."""

    class Two(OneBus):
        def lose(self, camera: str) -> None:
            if not self.done or (camera == "cam_b" and "cam_b" not in self.lost):
                super().lose(camera)

    async with robot_of(tmp_path, Two, bus()) as (runtime, robot):
        robot.lose("cam_a")
        repair = await the_repair(runtime)
    assert repair["state"] == "repaired"
    assert robot.done[-1] == "start_node(cam_b)"


HUB = """
robomend: 1
name: bus
hardware: {hub: {}, dev_a: {fed_by: [hub]}, dev_b: {fed_by: [hub]}}
nodes:
  cam_a: {drives: [dev_a], publishes: {img_a: []}}
  cam_b: {drives: [dev_b], publishes: {img_b: []}}
"""


class InTurn(OneBus):
    """Its cameras fail when they are told to, whatever is done to the other one."""

    def do(self, name: str, parameter: str) -> None:
        (self.up.add if name == "start_node" else self.up.discard)(parameter)
        (self.has.add if name == "start_node" else self.has.discard)(parameter)


@pytest.mark.parametrize(("hub", "ends"), [(False, "repaired"), (True, "escalated")])
async def test_who_the_model_knows_no_way_between_is_accused_on_more_than_one_turn(
    tmp_path: Path, hub: bool, ends: str
) -> None:
    """Each of two fails by itself as the other one was just restarted. Where one hub feeds both, the model
    knows a way from one to the other, and once is enough.
    """
    async with robot_of(tmp_path, InTurn, HUB if hub else bus()) as (runtime, robot):
        before = ""
        for camera in "aba":
            robot.lose(f"cam_{camera}")
            repair = await the_repair(runtime, after=before)
            before = repair["id"]
    assert repair["state"] == ends, repair["reason"]
    accused = "restarting cam_a breaks cam_b, and the other way round"
    assert (accused in repair["reason"]) == hub


async def test_faults_of_their_own_that_come_in_turn_are_not_blamed_on_each_others_repairs(
    tmp_path: Path,
) -> None:
    async with robot_of(tmp_path, InTurn, bus()) as (runtime, robot):
        before = ""
        for camera, after_s in (("a", 0.0), ("b", 1.3), ("a", 1.3), ("b", 2.6), ("a", 2.6)):
            await asyncio.sleep(after_s)  # what it does by itself, and when, is the case
            robot.lose(f"cam_{camera}")
            repair = await the_repair(runtime, after=before)
            before = repair["id"]
            assert (repair["state"], robot.done[-1]) == ("repaired", f"start_node(cam_{camera})")


def _in_turn(chance: random.Random, breaks_s: float | None) -> Iterator[tuple[list[Attempt], Attempt]]:
    """Yield what was tried and what is to be done, of two that fail 4 to 25 s after their own starts, or each
    so long after the other's.
    """
    fails_s = {"cam_a": 1.0, "cam_b": chance.uniform(4, 25) if breaks_s is None else 1e9}
    now_s, tried = 0.0, list[Attempt]()
    for _ in range(12):
        name = min(fails_s, key=fails_s.__getitem__)
        now_s = max(now_s, fails_s[name]) + chance.uniform(0.5, 1.0)
        actions = (f"stop_node({name})", f"start_node({name})")
        failed_ns = round(fails_s[name] * S_TO_NS)
        again = Attempt(frozenset({name}), frozenset(), 0, True, False, actions, symptom_ns=failed_ns)
        yield tried, again
        sent_s = (now_s, now_s + 0.3)
        now_s += chance.uniform(1.0, 3.0)
        sent_ns = tuple(round(one * S_TO_NS) for one in sent_s)
        done = {"time_ns": round(now_s * S_TO_NS), "helped": True, "began_ns": sent_ns[0], "sent_ns": sent_ns}
        tried.append(replace(again, **done))  # type: ignore[arg-type]  # fields by name
        fails_s[name] = 1e9
        if breaks_s is None:
            fails_s[name] = now_s + chance.uniform(4, 25)
        else:
            fails_s["cam_b" if name == "cam_a" else "cam_a"] = sent_s[1] + breaks_s + chance.uniform(0, 0.2)


@pytest.mark.parametrize(("model", "most", "soon"), [(HUB, 15, 4), (bus(), 3, 5)])
def test_two_that_flap_by_themselves_do_not_accuse_each_other_and_two_that_break_each_other_do(
    model: str, most: int, soon: int
) -> None:
    """Where one hub feeds both, the model knows a way from one to the other."""
    parts = parts_of(load_text(model))
    by_themselves = [
        any(undoing(tried, again, parts) for tried, again in _in_turn(random.Random(seed), None))
        for seed in range(300)
    ]
    assert sum(by_themselves) <= most  # a few are equally late by chance
    for seed in range(300):
        chance = random.Random(seed)
        turns = _in_turn(chance, chance.uniform(0, 25))
        found = (len(tried) for tried, again in turns if undoing(tried, again, parts))
        assert next(found, 99) <= soon, seed


async def test_what_fails_once_more_with_all_the_rest_was_not_broken_by_the_repair_of_a_part(
    tmp_path: Path,
) -> None:
    """Power goes, of everything, of one device, and of everything again: each is its own fault."""
    async with service(tmp_path) as runtime, robot_on(runtime) as robot:
        before = ""
        for fails in (robot.go_off, lambda: robot.cut("lidar"), robot.go_off):
            await robot.settled()
            fails()
            await robot.report()
            repair = await the_repair(runtime, after=before)
            before = repair["id"]
            assert repair["state"] == "repaired", repair["reason"]


MANAGED = ("controller", "map_server", "planner")

BOND = """
robomend: 1
name: bond
nodes:
  map_server: {publishes: {map: []}}
  planner: {publishes: {plan: [map]}}
  controller: {publishes: {cmd: [plan]}}
"""


@dataclass
class Managed(Robot):
    """Its nodes have a manager that the model does not know: it takes all down when one has died, and when
    one is started by somebody else.
    """

    running: dict[str, bool] = field(default_factory=lambda: dict.fromkeys(MANAGED, True))
    timer: asyncio.TimerHandle | None = None

    def do(self, name: str, parameter: str) -> None:
        self.running[parameter] = name == "start_node"
        if self.timer is not None:
            self.timer.cancel()
        # After a whole plan, on a busy computer too.
        self.timer = asyncio.get_running_loop().call_later(2.0, self.take_down)

    def take_down(self) -> None:
        self.running = dict.fromkeys(MANAGED, False)

    def facts(self) -> dict[str, bool]:
        runs = self.running
        maps = runs["map_server"]
        plans = maps and runs["planner"]
        facts = {f"running({name})": value for name, value in runs.items()}
        return facts | {"ok(map)": maps, "ok(plan)": plans, "ok(cmd)": plans and runs["controller"]}


async def test_what_goes_down_together_after_each_start_is_started_twice_and_told_so(tmp_path: Path) -> None:
    async with robot_of(tmp_path, Managed, BOND, detection_s=0.5) as (runtime, robot):
        robot.take_down()
        repair = await the_repair(runtime)
        while repair["state"] == "repaired":
            repair = await the_repair(runtime, after=repair["id"])
    assert repair["state"] == "escalated"
    together = "controller, map_server and planner go down again together soon after each start; "
    assert repair["reason"].startswith(together)
    assert max(robot.done.count(f"start_node({name})") for name in MANAGED) <= 2
