"""A robot in memory that a real service repairs: it pulls actions as an agent does, and reports.

Everything on the service's side is real (store, robots, engine, planner processes, repair loop); only the
robot is not, so that a test can make it misbehave to the millisecond.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from tests.waiting import look_s

from robomend.api.runtime import Runtime
from robomend.oneshots.oneshots import OneShots
from robomend.planning.planner_pool import PlannerPool
from robomend.repairs.repairs import Repairs, make_repairs
from robomend.robots.batches import Batch
from robomend.robots.clock import CLOCK
from robomend.robots.reporters import Reporter
from robomend.robots.robots import Robots
from robomend.settings import Settings
from robomend.store import Store
from robomend_client.readings import Reading, Symptom

MODEL = """
robomend: 1
name: small
hardware:
  base: {channel: 7}
  lidar: {channel: 3}
nodes:
  base_node: {drives: [base], publishes: {odom: []}}
  lidar_node: {drives: [lidar], publishes: {scan: []}}
  mapping: {publishes: {map: [scan]}}
"""

BOOTS_AT_ONCE = MODEL.replace("channel: 7", "channel: 7, boot_s: 0.1").replace(
    "channel: 3", "channel: 3, boot_s: 0.1"
)
"""Where nobody knows how long a device boots, the third start of its driver waits for a minute."""

HARDWARE = {"base": "base_node", "lidar": "lidar_node"}
NODES = ("base_node", "lidar_node", "mapping")
OBSERVED = (
    [f"on({h})" for h in HARDWARE] + [f"running({n})" for n in NODES] + ["ok(odom)", "ok(scan)", "ok(map)"]
)

SHUT_DOWN = ["power_up(base)", "stop_node(base_node)", "start_node(base_node)"]
"""What is done when the base has lost its power."""

CONFIG: dict[str, Any] = {
    "model": "small",
    "policy": "auto",
    "observed": OBSERVED,
    "observed_timeout_s": 3.0,
    "detection_s": 0.0,
    "limits": {"attempts_per_hour": 100, "rounds": 6},
    "actions": {
        name: {"executor": {"kind": "agent"}, "timeout_s": 20.0, "effect_timeout_s": 1.0}
        for name in ("power_up", "shutdown", "start_node", "stop_node")
    },
}


ONCE = """
(define (domain robot-repair)
  (:action recalibrate
    :parameters (?n - node)
    :precondition (and (running ?n) (bad ?n))
    :effect (and (good ?n) (not (bad ?n)) (increase (total-cost) 1))))
"""
"""A user's action, far cheaper than a restart, that is not declared idempotent."""


def with_recalibrate(timeout_s: float = 3.0) -> dict[str, Any]:
    """Return the configuration of a robot that can do it."""
    actions = {**CONFIG["actions"], "recalibrate": {"timeout_s": timeout_s, "effect_timeout_s": 1.0}}
    return {"domain": ONCE, "actions": actions}


planners: PlannerPool | None = None
"""Of the session, see conftest.py."""


@dataclass
class Robot:
    """State and behaviour. `spoil` may replace what an action does; it returns the result's code, or None."""

    repairs: Any
    robots: Any
    on: dict[str, bool] = field(default_factory=lambda: dict.fromkeys(HARDWARE, True))
    running: dict[str, bool] = field(default_factory=lambda: dict.fromkeys(NODES, True))
    connected: dict[str, bool] = field(default_factory=lambda: dict.fromkeys(HARDWARE.values(), True))
    done: list[str] = field(default_factory=list)
    ids: list[str] = field(default_factory=list)
    spoil: Callable[[Robot, str, str], Awaitable[int | None]] | None = None
    broken_topics: set[str] = field(default_factory=set)
    silent: bool = False
    message: str = ""  # of its next result
    onsets: dict[str, int] = field(default_factory=dict)  # sentence -> the last good sample before it
    kinds: dict[str, Symptom] = field(default_factory=dict)  # atom -> in which way it is bad, when it is
    id: str = "r1"

    def cut(self, device: str) -> None:
        """The device loses its power; its driver runs on, mute."""
        self.on[device] = False
        self.connected[HARDWARE[device]] = False

    def go_off(self) -> None:
        """Nothing of it has power or runs."""
        self.on = dict.fromkeys(self.on, False)
        self.running = dict.fromkeys(self.running, False)
        self.connected = dict.fromkeys(self.connected, False)

    def do(self, name: str, parameter: str) -> None:
        """What the action does on a robot that works."""
        if name == "power_up":
            self.on[parameter] = True
        elif name == "shutdown":
            self.cut(parameter)
        elif name in {"stop_node", "plant_fault"}:  # a drill's is that it is killed
            self.running[parameter] = False
            self.connected[parameter] = False
        elif name in {"start_node", "undo_fault"}:
            self.running[parameter] = True
            device = next((d for d, n in HARDWARE.items() if n == parameter), None)
            self.connected[parameter] = device is not None and self.on[device]

    def facts(self) -> dict[str, bool]:
        """Return what is so and what is not, as far as somebody observes it."""
        odom = self.running["base_node"] and self.connected["base_node"] and self.on["base"]
        scan = self.running["lidar_node"] and self.connected["lidar_node"] and self.on["lidar"]
        good = {"odom": odom, "scan": scan, "map": scan and self.running["mapping"]}
        facts = {f"on({h})": v for h, v in self.on.items()}
        facts |= {f"running({n})": v for n, v in self.running.items()}
        return facts | {f"ok({t})": v and t not in self.broken_topics for t, v in good.items()}

    def sentences(self) -> list[str]:
        """Return what the observers say."""
        return [fact if value else f"not {fact}" for fact, value in self.facts().items()]

    async def report(self) -> None:
        if not self.silent:
            sentences, now_ns = tuple(self.sentences()), CLOCK.now_ns()
            since = (now_ns,) * len(sentences)  # it knows what is so now, and rests on nothing older
            said = (self.kinds.get(one.removeprefix("not ")) if "not " in one else None for one in sentences)
            readings = tuple(None if kind is None else Reading("bad", symptom=kind) for kind in said)
            onset = tuple(map(self.onsets.get, sentences))
            about: dict[str, Any] = {"since": since, "onset": onset, "readings": readings}
            batch = Batch(sentences, source="test robot", time_ns=now_ns, **about)
            await self.robots.observe(self.id, batch)

    async def settled(self) -> None:
        """Wait until the service has diagnosed the robot as it is now."""
        await self.report()
        await self.robots.diagnosed(self.id)

    async def report_for_ever(self) -> None:
        while True:
            await self.report()
            await asyncio.sleep(0.05)

    async def act_for_ever(self) -> None:
        while True:
            action = await self.repairs.orders(self.id, host=None, wait_s=5.0)
            if action is None:
                continue
            parameter = action["parameters"][0]
            self.ids.append(action["id"])
            await self.repairs.feedback(action["id"], code=0, message="begun")
            code = await self.spoil(self, action["name"], parameter) if self.spoil else None
            if code is None:
                self.do(action["name"], parameter)
                code = 0
            self.done.append(f"{action['name']}({parameter})")
            await self.report()
            await self.repairs.result(action["id"], code=code, message=self.message, by=Reporter("robot"))


R = TypeVar("R", bound=Robot)


@asynccontextmanager
async def service(data: Path, **settings: Any) -> AsyncIterator[Runtime]:
    """Run the parts of a service, without HTTP, on the session's planners."""

    def with_planners(
        store: Store, robots: Robots, own: PlannerPool, one_shots: OneShots, settings: Settings
    ) -> Repairs:
        return make_repairs(store, robots, planners or own, one_shots, settings)

    runtime = Runtime(Settings(data=data, **settings), with_planners)
    async with runtime.lifespan(runtime.app):
        yield runtime


async def put_robot(runtime: Runtime, source: str = MODEL, **changes: Any) -> None:
    """Create robot r1 on the service, and the model that its configuration names."""
    config = {**CONFIG, **changes}
    with contextlib.suppress(Exception):  # it is there already
        await runtime.robots.models.put(config["model"], source, format=None, expected=None, by="test")
    await runtime.robots.put_robot("r1", config, expected=None, by="test")


@asynccontextmanager
async def robot_on(
    runtime: Runtime, kind: Callable[[Any, Any], Any] = Robot, **changes: Any
) -> AsyncIterator[Any]:
    """Create robot r1 on the service, and run it: one of this kind."""
    await put_robot(runtime, **changes)
    async with running(kind(runtime.repairs, runtime.robots)) as robot:
        yield robot


@asynccontextmanager
async def robot_of(
    data: Path, kind: Callable[[Any, Any], Any] = Robot, source: str = MODEL, **changes: Any
) -> AsyncIterator[tuple[Runtime, Any]]:
    """Run a service, and a robot of this kind and model that is well, and all of which is observed."""
    async with service(data) as runtime:
        robot = kind(runtime.repairs, runtime.robots)
        await put_robot(runtime, source, **{"observed": list(robot.facts()), **changes})
        async with running(robot):
            await robot.settled()
            yield runtime, robot


@asynccontextmanager
async def running(robot: R) -> AsyncIterator[R]:
    """Let the robot report and act until the end."""
    tasks = [asyncio.create_task(robot.report_for_ever()), asyncio.create_task(robot.act_for_ever())]
    try:
        yield robot
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)
    for task in tasks:  # a robot that fell over explains nothing about the service
        if not task.cancelled():
            task.result()


async def nothing_begins(runtime: Runtime, for_s: float = 0.5) -> None:
    """Look for a while that no repair begins. One begins within milliseconds of its diagnosis."""
    end = time.monotonic() + for_s
    while time.monotonic() < end:
        assert list(await runtime.repairs.repairs("r1", before=None, limit=1)) == []
        await asyncio.sleep(0.05)


async def the_repair(
    runtime: Runtime, robot: str = "r1", *, ended: bool = True, after: str = "", timeout_s: float = 60.0
) -> dict[str, Any]:
    """Return the robot's latest repair, no more `after`, once it has ended (or awaits approval)."""
    began, repair = time.monotonic(), dict[str, Any]()
    while (waited_s := time.monotonic() - began) < timeout_s:
        repairs = await runtime.repairs.repairs(robot, before=None, limit=1)
        if repairs and repairs[0]["id"] != after:
            repair = dict(repairs[0])
            if (repair["finished_ns"] is not None) if ended else repair["state"] == "awaiting-approval":
                return repair
        await asyncio.sleep(look_s(waited_s))  # until the next look
    raise AssertionError(f"waited {timeout_s:g} s in vain: {json.dumps(repair, indent=1, default=str)}")


async def repaired(
    data: Path,
    breaks: Callable[[Any], object],
    *,
    spoil: Callable[[Robot, str, str], Awaitable[int | None]] | None = None,
    kind: Callable[[Any, Any], Any] = Robot,
    timeout_s: float = 60.0,
    **changes: Any,
) -> tuple[dict[str, Any], Any]:
    """Return the repair of a robot of which something breaks, once it has ended, and the robot."""
    async with robot_of(data, kind, **changes) as (runtime, robot):
        robot.spoil = spoil
        breaks(robot)
        return await the_repair(runtime, timeout_s=timeout_s), robot


def answers(code: int, *names: str) -> Callable[[Robot, str, str], Awaitable[int | None]]:
    """Return what has these actions answered so, without effect."""

    async def spoiled(robot: Robot, name: str, parameter: str) -> int | None:
        return code if name in names else None

    return spoiled
