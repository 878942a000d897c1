"""Closed loop: how much the service takes in when everybody posts again as soon as they were answered.

Every single POST carries one change of one robot and is answered when it is on disk. NDJSON is what comes
when a robot was offline: one body of many lines.
"""

from __future__ import annotations

import asyncio
import json
import time
from dataclasses import dataclass

from robomend_bench.service.fleet import prepare
from robomend_bench.service.measure import Latency
from robomend_bench.service.robots import LITERALS, RECENT, SimulatedRobot, body
from robomend_bench.service.wire import connect, request


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
