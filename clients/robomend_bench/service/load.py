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
from collections import Counter, defaultdict, deque
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robomend_bench.parts import Figures
from robomend_bench.service.attack import beside, operator
from robomend_bench.service.process import Served, latency, model_text
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

    def __init__(self, name: str, seed: int, *, faults: int = 3, recent: int = RECENT) -> None:
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

    def acknowledged(self) -> frozenset[str]:
        """Return OBS as it must be now."""
        return frozenset(name if positive else f"not {name}" for name, positive in self.known.items())


def body(observations: list[str]) -> bytes:
    """Return a batch as JSON."""
    return json.dumps({"observations": observations}).encode()


async def prepare(url: str, robots: list[SimulatedRobot]) -> None:
    """Store the model and the robots, each sound, over a few connections."""
    connections = [await connect(url) for _ in range(16)]
    await connections[0].api("PUT", f"/models/{MODEL}", {"source": model_text()})

    async def some(connection: Connection, mine: list[SimulatedRobot]) -> None:
        for robot in mine:
            await connection.api("PUT", f"/robots/{robot.name}", {"model": MODEL, "policy": "observe"})
            path, sound = f"/robots/{robot.name}/observations", {"observations": robot.sound()}
            # A database that is used again knows the robot: its revisions go on.
            robot.is_at((await connection.api("POST", path, sound))["revision"])

    await asyncio.gather(*(some(c, robots[start::16]) for start, c in enumerate(connections)))
    for connection in connections:
        connection.close()


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


# --- changes and their diagnoses

MODEL = "bench-tedusar"
LEFT_S = 10.0
"""How long what is under way at the end may take."""

EVENT = re.compile(rb'"robot":\s*"([^"]+)".*?"revision":\s*(\d+)', re.DOTALL)


@dataclass
class _Run:
    """What is noted while it runs, in seconds."""

    acknowledged: list[float] = field(default_factory=list)
    refused: list[float] = field(default_factory=list)
    diagnosed: list[float] = field(default_factory=list)
    late: list[float] = field(default_factory=list)
    errors: Counter[str] = field(default_factory=Counter)
    busy: Counter[str] = field(default_factory=Counter)  # robot -> requests without an answer
    not_sent: int = 0
    waiting: dict[bytes, deque[tuple[int, float]]] = field(default_factory=lambda: defaultdict(deque))
    """Of each robot the accepted changes without a diagnosis: revision, when it was due."""
    told: dict[bytes, deque[tuple[int, float]]] = field(default_factory=lambda: defaultdict(deque))
    """Its diagnoses, of which revision and when, from the latest that was needed on: an event may come before
    the answer."""
    news: asyncio.Event = field(default_factory=asyncio.Event)

    def send(self, robot: SimulatedRobot, connection: Connection, due: float) -> None:
        """Send a change of a robot that was due then."""
        said, name = robot.change(), robot.name.encode()
        self.busy[robot.name] += 1
        self.late.append(time.perf_counter() - due)

        def answered(status: int, _: bytes) -> None:
            self.busy[robot.name] -= 1
            self.news.set()
            took = time.perf_counter() - due
            if status == 200:
                self.acknowledged.append(took)
                if robot.accepted(said):
                    self.waiting[name].append((robot.kept, due))
                    self._match(name)
                return
            self.errors[str(status) if status else "connection lost"] += 1
            if status == 503:
                self.refused.append(took)

        connection.send(request("POST", robot.path, body(said)), answered)

    def event(self, frame: bytes) -> None:
        """An event came: whose changes does it diagnose?"""
        if b"event: diagnosis" in frame and (found := EVENT.search(frame)):
            self.told[found[1]].append((int(found[2]), time.perf_counter()))
            self._match(found[1])
            self.news.set()

    def _match(self, robot: bytes) -> None:
        """Find the diagnosis of each accepted change of a robot: the first of its revision or a later one."""
        waiting, told = self.waiting[robot], self.told[robot]
        while waiting and told:
            revision, due = waiting[0]
            if told[0][0] < revision:
                told.popleft()
            else:
                waiting.popleft()
                self.diagnosed.append(told[0][1] - due)

    async def finish(self) -> None:
        """Wait for what is under way, but not for long."""
        deadline = time.perf_counter() + LEFT_S
        while (self.busy.total() or any(self.waiting.values())) and time.perf_counter() < deadline:
            await asyncio.sleep(0.02)


async def run_fleet(
    url: str,
    robots: list[SimulatedRobot],
    *,
    rate_hz: float,
    seconds: float,
    seed: int,
    queue: bool = True,
) -> Figures:
    """Let prepared robots post `rate_hz` changes a second each, and return what came of it.

    Without `queue` nothing is sent that is due while the robot's request before is under way, and times count
    from the sending.
    """
    run = _Run()
    stream = await follow(url, run.event)
    connections = [await connect(url) for _ in robots]
    phases = random.Random(seed)
    order = sorted((phases.random() / rate_hz, index) for index in range(len(robots)))
    turns = round(seconds * rate_hz)
    began = time.perf_counter() + 0.1
    for turn in range(turns):
        for number, (phase, index) in enumerate(order):
            due = began + turn / rate_hz + phase
            while (left := due - time.perf_counter()) > 0:
                await asyncio.sleep(left)
            if number % 50 == 0:
                await asyncio.sleep(0)  # the answers are read, however late we are
            robot = robots[index]
            if queue:
                run.send(robot, connections[index], due)
            elif run.busy[robot.name]:
                run.not_sent += 1
            else:
                run.send(robot, connections[index], time.perf_counter())
    await run.finish()
    took = time.perf_counter() - began
    asker = await connect(url)
    lost = await differences(asker, robots)
    stream.close()
    for connection in (*connections, asker):
        connection.close()
    return {
        "robots": len(robots),
        "asked_per_s": round(len(robots) * rate_hz, 1),
        "due": turns * len(robots),
        "not_sent": run.not_sent,
        "accepted_per_s": round(len(run.acknowledged) / max(took, seconds), 1),
        "errors": dict(run.errors),
        "lost": lost,  # robots whose state is not what was accepted, with the difference
        "undiagnosed": sum(map(len, run.waiting.values())),
        "acknowledged": latency(run.acknowledged),
        "refused": latency(run.refused),
        "diagnosed": latency(run.diagnosed),
        "sent_late": latency(run.late),  # the generator's own lateness
    }


async def run_single(url: str, *, changes: int, pause_s: float, seed: int) -> Figures:
    """Post one change after another, each after the diagnosis of the one before; count from the POST."""
    # Of a name of its own, as revisions go on where an earlier run's robot left them.
    robot = SimulatedRobot(f"bench-single-{pause_s * 1000:g}", seed)
    await prepare(url, [robot])
    run = _Run()
    stream = await follow(url, run.event, f"/api/v1/robots/{robot.name}/events")
    connection = await connect(url)
    for _ in range(changes):
        run.news.clear()
        run.send(robot, connection, time.perf_counter())
        async with asyncio.timeout(LEFT_S):
            while run.busy.total() or any(run.waiting.values()):
                await run.news.wait()
                run.news.clear()
        await asyncio.sleep(pause_s)
    stream.close()
    connection.close()
    if run.errors:
        raise RuntimeError(f"errors: {dict(run.errors)}")
    return {"acknowledged": latency(run.acknowledged), "diagnosed": latency(run.diagnosed)}


async def run_posts(url: str, *, writers: int, seconds: float) -> Figures:
    """Let each writer post one observation after another for its own robot, for so many seconds."""
    robots = [SimulatedRobot(f"bench-writer-{number}", 1) for number in range(writers)]
    await prepare(url, robots)
    taken: list[float] = []
    errors: Counter[str] = Counter()
    began = time.perf_counter()

    async def write(robot: SimulatedRobot) -> None:
        connection = await connect(url)
        while (sent := time.perf_counter()) < began + seconds:
            status, _ = await connection.ask(request("POST", robot.path, body(robot.change())))
            if status == 200:
                taken.append(time.perf_counter() - sent)
            else:
                errors[str(status)] += 1
        connection.close()

    await asyncio.gather(*map(write, robots))
    per_s = round(len(taken) / (time.perf_counter() - began), 1)
    return {"writers": writers, "per_s": per_s, "latency": latency(taken), "errors": dict(errors)}


async def run_ndjson(url: str, *, observations: int, per_line: int) -> Figures:
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
    connection = await connect(url)
    wire = request("POST", robot.path, b"\n".join(lines) + b"\n", "application/x-ndjson")
    began = time.perf_counter()
    status, answer = await connection.ask(wire)
    elapsed = time.perf_counter() - began
    connection.close()
    accepted = json.loads(answer).get("accepted")
    if status != 200 or accepted != count * per_line:
        raise RuntimeError(
            f"NDJSON: {status}, {accepted} of {count * per_line} observations: {answer[:300]!r}"
        )
    return {"lines": count, "observations_per_s": round(accepted / elapsed)}


OVERLOAD = 2.0
"""Times what the service can take."""

LOOKS = 5
"""At health and readiness, for each stop that is set and lifted: that wakes every robot's repairs."""


async def run_overload(url: str, *, robots: int, seconds: float, writers: int, seed: int) -> Figures:
    """Ask for more changes than can be taken, for so many seconds, and as an operator beside."""
    closed = await run_posts(url, writers=writers, seconds=min(seconds, 10.0))
    fleet = [SimulatedRobot(f"over-{number}", seed) for number in range(robots)]
    await prepare(url, fleet)
    rate_hz = OVERLOAD * closed["per_s"] / robots
    with beside(operator, url, "", LOOKS) as seen:
        found = await run_fleet(url, fleet, rate_hz=rate_hz, seconds=seconds, seed=seed, queue=False)
    found["errors"].pop("503", None)  # as it should be
    errors = found["errors"] | dict(Counter(seen["errors"]))
    return found | {"sustainable_per_s": closed["per_s"], "errors": errors, "operator": seen["times"]}


# --- the SQLite file before and after

HOUR = 3600
"""Reports of a robot that says the same every second."""

CHANGES_A_SECOND = 50.0
"""Few enough for a busy machine: what counts is the file, not the time."""


async def run_growth(served: Served, *, robots: int, changes: int, seed: int) -> Figures:
    """Let robots report so many changes in all, each diagnosed with something new; then what is known: dated,
    with a lifetime and a key each, as an agent does once a second. Return the bytes by which the file grew.
    """
    path = served.data / "robomend.db"
    fleet = [SimulatedRobot(f"r{n}", seed) for n in range(robots)]
    await prepare(served.url, fleet)
    before, rows_before = _size(path)
    rate_hz = CHANGES_A_SECOND / robots
    run = await run_fleet(served.url, fleet, rate_hz=rate_hz, seconds=changes / CHANGES_A_SECOND, seed=seed)
    after, rows = _size(path)
    connection = await connect(served.url)
    known = 0
    for number in range(-len(fleet), HOUR):
        robot = fleet[number % len(fleet)]
        told = {"observations": sorted(robot.acknowledged()), "time": time.time_ns(), "lifetime_s": 3600}
        wire = request("POST", robot.path, json.dumps(told).encode(), Idempotency_Key=f"hour-{number}")
        status, _ = await connection.ask(wire)
        if status != 200:
            raise RuntimeError(f"an unchanged batch was answered {status}")
        if number == -1:  # each has a lifetime now
            known, _ = _size(path)
    connection.close()
    return {
        "changes": rows - rows_before,
        "bytes_a_change": round((after - before) / max(1, rows - rows_before), 1),
        "bytes_an_hour_of_nothing_new": _size(path)[0] - known,
        "errors": run["errors"],
        "lost": run["lost"],
    }


def _size(path: Path) -> tuple[int, int]:
    """Return the bytes of the file after a checkpoint, and how many batches it has."""

    def one(sql: str) -> Any:
        return database.execute(sql).fetchone()[0]

    with closing(sqlite3.connect(path, timeout=30.0)) as database:
        one("PRAGMA wal_checkpoint(TRUNCATE)")
        batches: int = one("SELECT count(*) FROM events WHERE batch IS NOT NULL")
        return one("PRAGMA page_count") * one("PRAGMA page_size"), batches
