"""Open loop: a fleet posts its changes on time, whether or not the service keeps up.

    plan: robot r is due at phase(r), phase(r) + 1/rate, …   ──► POST ──► acknowledged ──► event `diagnosis`
                        └─────────────── latency counts from when it was due ────────────────────┘

A service that stalls for a second thus shows a thousand latencies of up to a second, not one
("coordinated omission"). A change counts as diagnosed with the first published diagnosis of its revision or
a later one of the same robot: changes that come while a robot's diagnosis is under way are diagnosed
together. Nothing may be lost: in the end each robot's OBS and revision are compared with what was accepted;
what was not is counted as errors, by status.
"""

from __future__ import annotations

import asyncio
import json
import random
import re
import time
from collections import deque
from dataclasses import dataclass, field

from robomend_bench.service.measure import Latency, cpu_s, load_of_others
from robomend_bench.service.process import Served, model_text
from robomend_bench.service.robots import SimulatedRobot, body
from robomend_bench.service.wire import Connection, connect, follow, request

MODEL = "bench-tedusar"
LEFT_S = 10.0
"""How long what is under way at the end may take."""

EVENT = re.compile(rb'"robot":\s*"([^"]+)".*?"revision":\s*(\d+)', re.DOTALL)


@dataclass(frozen=True, slots=True)
class FleetResult:
    """What a run showed."""

    robots: int
    seconds: float
    due: int  # changes
    asked_per_s: float
    achieved_per_s: float  # acknowledged changes over the time that it took
    errors: dict[str, int]
    lost: tuple[str, ...]  # robots whose state is not what was accepted, with the difference
    undiagnosed: int  # accepted changes without a diagnosis
    coalesced: int  # diagnosed together with a later change
    acknowledged: Latency
    diagnosed: Latency
    sent_late: Latency  # the generator's own lateness
    service_cpu: float | None  # cores
    cpu_ms_a_change: float | None  # of the service; what tells most on a machine that others use too
    generator_cpu: float
    load: float  # of the machine, at the end
    cached: float | None  # share of the diagnoses that were answered from memory


@dataclass(slots=True)
class _Told:
    """A published diagnosis."""

    revision: int
    at_s: float
    needed: bool = False  # by a change already


@dataclass
class _Run:
    """What is noted while it runs."""

    acknowledged: list[float] = field(default_factory=list)
    diagnosed: list[float] = field(default_factory=list)
    late: list[float] = field(default_factory=list)
    errors: dict[str, int] = field(default_factory=dict)
    coalesced: int = 0
    open: int = 0  # requests without an answer
    waiting: dict[bytes, deque[tuple[int, float]]] = field(default_factory=dict)
    """Of each robot the accepted changes without a diagnosis: revision, when it was due."""
    told: dict[bytes, deque[_Told]] = field(default_factory=dict)
    """Its diagnoses from the latest that was needed on: an event may come before the answer."""
    last_answer: float = 0.0
    news: asyncio.Event = field(default_factory=asyncio.Event)

    def event(self, frame: bytes) -> None:
        """An event came: whose changes does it diagnose?"""
        if b"event: diagnosis" not in frame:
            return
        now = time.perf_counter()
        found = EVENT.search(frame)
        if found is None:
            return
        if found[1] not in self.waiting:
            return
        self.told.setdefault(found[1], deque()).append(_Told(int(found[2]), now))
        self.match(found[1])
        self.news.set()

    def match(self, robot: bytes) -> None:
        """Find the diagnosis of each accepted change of a robot: the first of its revision or a later one."""
        waiting, told = self.waiting[robot], self.told.get(robot)
        while waiting and told:
            revision, due = waiting[0]
            if told[0].revision < revision:
                told.popleft()
                continue
            waiting.popleft()
            self.diagnosed.append(told[0].at_s - due)
            self.coalesced += told[0].needed
            told[0].needed = True


async def prepare(url: str, robots: list[SimulatedRobot], *, policy: str = "observe") -> None:
    """Store the model and the robots, each sound, over a few connections."""
    connections = [await connect(url) for _ in range(16)]
    await connections[0].api("PUT", f"/models/{MODEL}", {"source": model_text()})

    async def some(connection: Connection, mine: list[SimulatedRobot]) -> None:
        for robot in mine:
            await connection.api("PUT", f"/robots/{robot.name}", {"model": MODEL, "policy": policy})
            path, sound = f"/robots/{robot.name}/observations", {"observations": robot.sound()}
            # A database that is used again knows the robot: its revisions go on.
            robot.is_at((await connection.api("POST", path, sound))["revision"])

    await asyncio.gather(*(some(c, robots[start::16]) for start, c in enumerate(connections)))
    for connection in connections:
        connection.close()


async def run_fleet(
    url: str,
    robots: list[SimulatedRobot],
    *,
    rate_hz: float,
    seconds: float,
    seed: int,
    served: Served | None = None,
) -> FleetResult:
    """Let prepared robots post `rate_hz` changes a second each, and return what came of it."""
    run = _Run(waiting={robot.name.encode(): deque() for robot in robots})
    stream = await follow(url, run.event)
    connections = [await connect(url) for _ in robots]
    asker = await connect(url)
    before = await _diagnoses(asker)
    asker.close()  # the service would, after 30 s without a word
    phases = random.Random(seed)
    order = sorted((phases.random() / rate_hz, index) for index in range(len(robots)))
    turns = round(seconds * rate_hz)
    cpu_before = cpu_s(served.pid) if served else 0.0
    own_before = time.process_time()
    began = time.perf_counter() + 0.1
    for turn in range(turns):
        for phase, index in order:
            due = began + turn / rate_hz + phase
            while (left := due - time.perf_counter()) > 0:
                await asyncio.sleep(left)
            _send(run, robots[index], connections[index], due)
        await asyncio.sleep(0)
    deadline = time.perf_counter() + LEFT_S
    while (run.open or any(run.waiting.values())) and time.perf_counter() < deadline:
        await asyncio.sleep(0.05)
    took = max(run.last_answer - began, 1e-9)
    elapsed = time.perf_counter() - began
    count = max(1, len(run.acknowledged))
    service_cpu = None if served is None else (cpu_s(served.pid) - cpu_before) / elapsed
    own_cpu = (time.process_time() - own_before) / elapsed
    load = load_of_others()
    asker = await connect(url)
    after = await _diagnoses(asker)
    lost = await differences(asker, robots)
    stream.close()
    for connection in (*connections, asker):
        connection.close()
    made = {place: after[place] - before.get(place, 0.0) for place in after}
    total = sum(made.values())
    return FleetResult(
        robots=len(robots),
        seconds=seconds,
        due=turns * len(robots),
        asked_per_s=len(robots) * rate_hz,
        achieved_per_s=round(len(run.acknowledged) / max(took, seconds), 1),
        errors=run.errors,
        lost=tuple(lost),
        undiagnosed=sum(map(len, run.waiting.values())),
        coalesced=run.coalesced,
        acknowledged=Latency.of(run.acknowledged),
        diagnosed=Latency.of(run.diagnosed),
        sent_late=Latency.of(run.late),
        service_cpu=None if service_cpu is None else round(service_cpu, 2),
        cpu_ms_a_change=None if service_cpu is None else round(1e3 * service_cpu * elapsed / count, 3),
        generator_cpu=round(own_cpu, 2),
        load=round(load, 1),
        cached=round(made.get("cache", 0.0) / total, 2) if total else None,
    )


def _send(run: _Run, robot: SimulatedRobot, connection: Connection, due: float) -> None:
    said, name = robot.change(), robot.name.encode()
    run.open += 1
    run.late.append(time.perf_counter() - due)

    def answered(status: int, text: bytes) -> None:
        run.open -= 1
        run.last_answer = time.perf_counter()
        run.news.set()
        if status != 200:
            error = str(status) if status else "connection lost"
            run.errors[error] = run.errors.get(error, 0) + 1
            return
        run.acknowledged.append(run.last_answer - due)
        if robot.accepted(said):
            run.waiting[name].append((robot.kept, due))
            run.match(name)

    connection.send(request("POST", robot.path, body(said)), answered)


async def _diagnoses(connection: Connection) -> dict[str, float]:
    """Return how many diagnoses were made where, by the service's own count."""
    _, text = await connection.ask(request("GET", "/metrics"))
    counts: dict[str, float] = {}
    for line in text.decode().splitlines():
        found = re.match(r'robomend_diagnoses_total\{[^}]*"(\w+)"\} (\S+)', line)
        if found:
            counts[found[1]] = float(found[2])
    return counts


async def differences(connection: Connection, robots: list[SimulatedRobot]) -> list[str]:
    """Return what the service does not know as it has accepted it, robot by robot."""
    lost = []
    for robot in robots:
        obs = await connection.api("GET", f"/robots/{robot.name}/observations")
        if obs["revision"] != robot.kept:
            lost.append(f"{robot.name}: revision {obs['revision']}, accepted {robot.kept}")
            continue
        known = frozenset(entry["literal"] for entry in obs["observations"])
        if known != robot.acknowledged():
            lost.append(f"{robot.name}: {json.dumps(sorted(known ^ robot.acknowledged()))}")
    return lost


@dataclass(frozen=True, slots=True)
class SingleResult:
    """One robot, nothing else going on."""

    acknowledged: Latency
    diagnosed: Latency
    load: float


async def run_single(url: str, *, changes: int, pause_s: float = 0.01, seed: int = 1) -> SingleResult:
    """Post one change after another, each after the diagnosis of the one before; count from the POST."""
    # Of a name of its own, as revisions go on where an earlier run's robot left them.
    robot = SimulatedRobot(f"bench-single-{pause_s * 1000:g}", seed, faults=3)
    await prepare(url, [robot])
    run = _Run(waiting={robot.name.encode(): deque()})
    stream = await follow(url, run.event, f"/api/v1/robots/{robot.name}/events")
    connection = await connect(url)
    waiting = run.waiting[robot.name.encode()]
    for _ in range(changes):
        run.news.clear()
        _send(run, robot, connection, time.perf_counter())
        async with asyncio.timeout(LEFT_S):
            while run.open or waiting:
                await run.news.wait()
                run.news.clear()
        await asyncio.sleep(pause_s)
    stream.close()
    connection.close()
    if run.errors or waiting:
        raise RuntimeError(f"errors {run.errors}, without a diagnosis: {len(waiting)}")
    return SingleResult(Latency.of(run.acknowledged), Latency.of(run.diagnosed), round(load_of_others(), 1))
