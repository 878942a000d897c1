"""Robots under load: a fleet (open loop), closed loops, more than the service can take, what it keeps.

    plan: robot r is due at phase(r), phase(r) + 1/rate, …   ──► POST ──► acknowledged ──► event `diagnosis`
                        └─────────────── latency counts from when it was due ────────────────────┘

A service that stalls for a second thus shows a thousand latencies of up to a second, not one
("coordinated omission"). A change counts as diagnosed with the first published diagnosis of its revision or
a later one of the same robot: changes that come while a robot's diagnosis is under way are diagnosed
together. Nothing may be lost: in the end each robot's OBS and revision are compared with what was accepted;
what was not is counted as errors, by status.

Faults come to the robots and leave them, and each change of theirs changes the diagnosis, whatever was
before: every node of the model is running or not, every switchable device on or off, and by the six schemes
each literal has a conflict of its own. Which literal changes is drawn by chance, so that the robots of a
fleet are in different states and few questions are asked twice.
"""

from __future__ import annotations

import asyncio
import json
import random
import re
import sqlite3
import time
from collections import deque
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from robomend_bench.service.attack import beside
from robomend_bench.service.process import Latency, Served, cpu_s, load_of_others, model_text
from robomend_bench.service.wire import Connection, connect, follow, request

LITERALS = (
    "running(jaguar_node)",
    "running(hokuyo_node)",
    "running(laser_alignment_node)",
    "running(imu_node)",
    "running(joy_node)",
    "running(jaguar_teleop_node)",
    "running(hector_mapping)",
    "running(rviz)",
    "running(laser_alignment_control)",
    "on(jaguar)",
    "on(hokuyo)",
    "on(laser_alignment)",
)
"""Of examples/tedusar.yaml."""


RECENT = 3
"""Literals left alone for so many changes: what is diagnosed together must not cancel out."""


class SimulatedRobot:
    """One robot: what its observers would say, and what the service must know in the end."""

    def __init__(self, name: str, seed: int, *, faults: int, recent: int = RECENT) -> None:
        """About `faults` literals are false at a time, at most; of `recent` + 1 changes each is another's."""
        self.name = name
        self.path = f"/api/v1/robots/{name}/observations"
        self.revision = 0  # after the changes that were sent
        self.holds = dict.fromkeys(LITERALS, True)
        self.kept = 0  # revision after the changes that the service has accepted
        self.known: dict[str, bool] = {}  # what it knows by them
        self._random = random.Random(f"{name} {seed}")
        self._faults = faults
        self._recent: deque[str] = deque(maxlen=recent)

    def sound(self) -> list[str]:
        """Return what a healthy robot reports: the state before the first change."""
        self.is_at(1)
        self.known = dict.fromkeys(LITERALS, True)
        return list(LITERALS)

    def is_at(self, revision: int) -> None:
        """The service knows the robot at this revision."""
        self.revision = self.kept = revision

    def accepted(self, said: list[str]) -> bool:
        """The service has accepted an observation. Return whether that was news to it: what came before may
        have been refused.
        """
        told = {sentence.removeprefix("not "): not sentence.startswith("not ") for sentence in said}
        news = not told.items() <= self.known.items()
        self.known |= told
        self.kept += news
        return news

    def change(self) -> list[str]:
        """Return the observation of a change: a fault that comes, or one that goes."""
        false = [name for name, holds in self.holds.items() if not holds and name not in self._recent]
        true = [name for name, holds in self.holds.items() if holds and name not in self._recent]
        many = list(self.holds.values()).count(False) >= self._faults
        goes = not true or (bool(false) and (many or self._random.random() < 0.5))
        name = self._random.choice(false if goes else true)
        self._recent.append(name)
        self.holds[name] = goes
        self.revision += 1
        return [name if goes else f"not {name}"]

    def take_back(self) -> None:
        """Undo the latest change: the service has refused it."""
        name = self._recent[-1]
        self.holds[name] = not self.holds[name]
        self.revision -= 1

    def expected(self) -> frozenset[str]:
        """Return OBS as it must be once all is accepted."""
        return _literals(self.holds)

    def acknowledged(self) -> frozenset[str]:
        """Return OBS as it must be now."""
        return _literals(self.known)


def _literals(holds: dict[str, bool]) -> frozenset[str]:
    return frozenset(name if positive else f"not {name}" for name, positive in holds.items())


def body(observations: list[str]) -> bytes:
    """Return a batch as JSON."""
    return json.dumps({"observations": observations}).encode()


# --- open loop

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
    lost = await differences(asker, robots)
    stream.close()
    for connection in (*connections, asker):
        connection.close()
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


# --- closed loops


@dataclass(frozen=True, slots=True)
class DurableResult:
    """Acknowledged posts."""

    writers: int
    posts: int
    per_s: float
    latency: Latency
    errors: int


async def run_posts(url: str, *, writers: int, seconds: float) -> DurableResult:
    """Let each writer post one observation after another for its own robot, for so many seconds."""
    robots = [SimulatedRobot(f"bench-writer-{number}", 1, faults=3) for number in range(writers)]
    await prepare(url, robots)
    taken: list[float] = []
    errors = 0
    began = time.perf_counter()
    end = began + seconds

    async def write(robot: SimulatedRobot) -> None:
        nonlocal errors
        connection = await connect(url)
        while (sent := time.perf_counter()) < end:
            status, _ = await connection.ask(request("POST", robot.path, body(robot.change())))
            if status == 200:
                taken.append(time.perf_counter() - sent)
            else:
                errors += 1
        connection.close()

    await asyncio.gather(*map(write, robots))
    elapsed = time.perf_counter() - began
    return DurableResult(writers, len(taken), round(len(taken) / elapsed, 1), Latency.of(taken), errors)


@dataclass(frozen=True, slots=True)
class NdjsonResult:
    """One body, taken in."""

    lines: int
    observations: int
    per_s: float  # observations
    megabytes: float


async def run_ndjson(url: str, *, observations: int, per_line: int) -> NdjsonResult:
    """Post one body with `per_line` observations a line; the answer comes when all of it is on disk."""
    # A line is of one moment: it says nothing twice.
    recent = max(RECENT, per_line - 1)
    robot = SimulatedRobot(f"bench-ndjson-{per_line}", 1, faults=len(LITERALS), recent=recent)
    await prepare(url, [robot])
    count = observations // per_line
    now = time.time_ns() - count * 1_000_000
    lines = []
    for number in range(count):
        sentences = [sentence for _ in range(per_line) for sentence in robot.change()]
        lines.append(json.dumps({"observations": sentences, "time": now + number * 1_000_000}).encode())
    text = b"\n".join(lines) + b"\n"
    connection = await connect(url)
    wire = request("POST", robot.path, text, "application/x-ndjson")
    began = time.perf_counter()
    status, answer = await connection.ask(wire)
    elapsed = time.perf_counter() - began
    connection.close()
    if status != 200:
        raise RuntimeError(f"NDJSON: {status} {answer[:300]!r}")
    accepted = json.loads(answer)["accepted"]
    if accepted != count * per_line:
        raise RuntimeError(f"NDJSON: {accepted} of {count * per_line} observations were accepted")
    return NdjsonResult(count, accepted, round(accepted / elapsed), round(len(text) / 1e6, 1))


# --- more than it can take

LOOKS = 5
"""At health and readiness, for each stop that is set and lifted: that wakes every robot's repairs."""


@dataclass(frozen=True, slots=True)
class OverloadResult:
    """What a run showed."""

    sustainable_per_s: float
    asked_per_s: float
    accepted_per_s: float
    accepted: Latency  # from when it was sent
    refused: Latency  # 503
    not_sent: int  # due while the robot's request before was under way
    errors: dict[str, int]  # any other answer
    lost: tuple[str, ...]  # robots whose state is not what was accepted, with the difference
    operator: dict[str, Latency]  # kind of request -> what somebody else waited for its answer
    sent_late: Latency  # the generator's own lateness


@dataclass
class _Overload:
    times: dict[int, list[float]] = field(default_factory=lambda: {200: [], 503: []})
    errors: dict[str, int] = field(default_factory=dict)
    busy: set[str] = field(default_factory=set)  # robots with a request under way
    not_sent: int = 0
    late: list[float] = field(default_factory=list)

    def send(self, robot: SimulatedRobot, connection: Connection, due: float) -> None:
        """Send a change of a robot that was due then."""
        if robot.name in self.busy:
            self.not_sent += 1
            return
        self.busy.add(robot.name)
        said = robot.change()
        sent = time.perf_counter()
        self.late.append(sent - due)

        def answered(status: int, _: bytes) -> None:
            self.busy.discard(robot.name)
            if status in self.times:
                self.times[status].append(time.perf_counter() - sent)
            else:
                self.errors[str(status)] = self.errors.get(str(status), 0) + 1
            if status == 200:
                robot.accepted(said)
            elif status == 503:  # else its opposite, later, would say nothing new
                robot.take_back()

        connection.send(request("POST", robot.path, body(said)), answered)


async def run_overload(
    url: str, *, robots: int, factor: float, seconds: float, writers: int, seed: int
) -> OverloadResult:
    """Ask for `factor` times as many changes as can be taken, for so many seconds."""
    closed = await run_posts(url, writers=writers, seconds=min(seconds, 10.0))
    fleet = [SimulatedRobot(f"over-{number}", seed, faults=3) for number in range(robots)]
    await prepare(url, fleet)
    connections = [await connect(url) for _ in fleet]
    run, every_s = _Overload(), 1 / (factor * closed.per_s)
    with beside("operator", url, str(LOOKS), told="") as operator:
        began = time.perf_counter()
        for number in range(round(seconds / every_s)):
            due = began + number * every_s
            while (left := due - time.perf_counter()) > 0:
                await asyncio.sleep(left)
            if number % 50 == 0:
                await asyncio.sleep(0)  # the answers are read, however late we are
            run.send(fleet[number % robots], connections[number % robots], due)
        took = time.perf_counter() - began
        deadline = time.perf_counter() + LEFT_S
        while run.busy and time.perf_counter() < deadline:
            await asyncio.sleep(0.05)
    asker = await connect(url)
    lost = await differences(asker, fleet)
    for connection in (*connections, asker):
        connection.close()
    if run.busy:
        run.errors["no answer"] = len(run.busy)
    for error in operator["errors"]:
        run.errors[error] = run.errors.get(error, 0) + 1
    return OverloadResult(
        sustainable_per_s=closed.per_s,
        asked_per_s=round(factor * closed.per_s, 1),
        accepted_per_s=round(len(run.times[200]) / max(took, seconds), 1),
        accepted=Latency.of(run.times[200]),
        refused=Latency.of(run.times[503]),
        not_sent=run.not_sent,
        errors=run.errors,
        lost=tuple(lost),
        operator={asked: Latency(**took) for asked, took in operator["times"].items()},
        sent_late=Latency.of(run.late),
    )


# --- the SQLite file before and after

HOUR = 3600
"""Reports of a robot that says the same every second."""

CHANGES_A_SECOND = 50.0
"""Few enough for a busy machine: what counts is the file, not the time."""


@dataclass(frozen=True, slots=True)
class Growth:
    """Bytes of the file."""

    robots: int
    changes: int
    bytes_a_change: float
    bytes_an_hour: float  # of one robot that reports the same every second
    tables: dict[str, float]  # a change, with their indexes; where SQLite tells it
    errors: dict[str, int]  # changes that were not accepted
    lost: tuple[str, ...]


async def run_growth(served: Served, *, robots: int, changes: int, seed: int, repeats: int = HOUR) -> Growth:
    """Let robots report so many changes in all, each diagnosed with something new; then what is known."""
    path = served.data / "robomend.db"
    fleet = [SimulatedRobot(f"r{n}", seed, faults=3) for n in range(robots)]
    await prepare(served.url, fleet)
    before, tables_before, rows_before = _sizes(path)
    rate_hz = CHANGES_A_SECOND / robots
    run = await run_fleet(served.url, fleet, rate_hz=rate_hz, seconds=changes / CHANGES_A_SECOND, seed=seed)
    after, tables, rows = _sizes(path)
    count = max(1, rows - rows_before)
    unchanged = await _unchanged(served, fleet, repeats)
    grown = {name: (size - tables_before.get(name, 0)) / count for name, size in tables.items()}
    return Growth(
        robots,
        count,
        round((after - before) / count, 1),
        unchanged,
        {name: round(size, 1) for name, size in sorted(grown.items()) if size > 0},
        run.errors,
        run.lost,
    )


async def _unchanged(served: Served, fleet: list[SimulatedRobot], repeats: int) -> float:
    """Report what is known, as fast as it goes, as an agent would once a second: dated, with a lifetime and a
    key of its own. Return the bytes by which the file has grown, for an hour of one robot.
    """
    path, connection, before = served.data / "robomend.db", await connect(served.url), 0
    for number in range(-len(fleet), repeats):
        robot = fleet[number % len(fleet)]
        told = {"observations": sorted(robot.acknowledged()), "time": time.time_ns(), "lifetime_s": 3600}
        wire = request("POST", robot.path, json.dumps(told).encode(), Idempotency_Key=f"hour-{number}")
        status, _ = await connection.ask(wire)
        if status != 200:
            raise RuntimeError(f"an unchanged batch was answered {status}")
        if number == -1:  # each has a lifetime now
            before, _, _ = _sizes(path)
    connection.close()
    after, _, _ = _sizes(path)
    return (after - before) * HOUR / repeats


def _sizes(path: Path) -> tuple[int, dict[str, int], int]:
    """Return the bytes of the file after a checkpoint, of its tables, and how many batches it has."""
    with closing(sqlite3.connect(path, timeout=30.0)) as database:
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        [pages] = database.execute("PRAGMA page_count").fetchone()
        [size] = database.execute("PRAGMA page_size").fetchone()
        [batches] = database.execute("SELECT count(*) FROM events WHERE batch IS NOT NULL").fetchone()
        of_index = dict(database.execute("SELECT name, tbl_name FROM sqlite_master"))
        tables: dict[str, int] = {}
        try:
            parts = database.execute("SELECT name, sum(pgsize) FROM dbstat GROUP BY name").fetchall()
        except sqlite3.OperationalError:  # a SQLite that was built without this table
            parts = []
        for name, taken in parts:
            table = of_index.get(name, name)
            tables[table] = tables.get(table, 0) + taken
        return pages * size, tables, batches
