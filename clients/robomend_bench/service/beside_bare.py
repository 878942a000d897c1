"""Processor time a change and the time to its answer, beside a bare handler with the same group commit.

On a machine that others use, times of the wall say little; processor time says more, and its ratio in turns
the most: what slows one down slows down the other. Times to the answer count from when a change was due.
"""

from __future__ import annotations

import asyncio
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from robomend_bench.service.fleet import prepare
from robomend_bench.service.measure import Latency, cpu_s
from robomend_bench.service.process import Served
from robomend_bench.service.robots import SimulatedRobot, body
from robomend_bench.service.wire import Connection, connect, follow, request

ANSWERS_S = 30.0


@dataclass(frozen=True, slots=True)
class BesideBare:
    """What each turn showed: milliseconds of the processor a change, and times to the acknowledgement."""

    asked_per_s: float
    service_ms: tuple[float, ...]
    bare_ms: tuple[float, ...]
    service_answers: tuple[Latency, ...]
    bare_answers: tuple[Latency, ...]
    errors: int

    @property
    def ratio(self) -> float:
        """The median of the ratios of the turns."""
        return statistics.median(s / b for s, b in zip(self.service_ms, self.bare_ms, strict=True))


@contextmanager
def bare(database: str) -> Iterator[tuple[str, int]]:
    """Run the bare handler; yield its URL and process."""
    with tempfile.TemporaryDirectory(prefix="robomend-bench-") as folder:
        arguments = [folder, *([database] if database else [])]
        process = subprocess.Popen(
            [sys.executable, "-m", "robomend_bench.service.bare", *arguments],
            stdout=subprocess.PIPE,
            process_group=0,  # Ctrl-C is for the bench, which ends it
        )
        assert process.stdout is not None
        try:
            yield json.loads(process.stdout.readline())["url"], process.pid
        finally:
            process.kill()
            process.wait(30)
            process.stdout.close()


async def run_beside_bare(
    served: Served, *, robots: int, rate_hz: float, seconds: float, turns: int, seed: int, database: str = ""
) -> BesideBare:
    """Post the same changes to both, at the same rate, first to the one and then to the other."""
    # A fleet for each: of one for both, each would hear of every other turn's changes only, and the service
    # would hold faults that have long gone.
    fleets = {
        side: [SimulatedRobot(f"r{n}", seed, faults=3) for n in range(robots)] for side in (True, False)
    }
    await prepare(served.url, fleets[True])
    stream = await follow(served.url, lambda _: None)  # diagnoses are published to somebody
    found: dict[bool, list[float]] = {True: [], False: []}
    answers: dict[bool, list[Latency]] = {True: [], False: []}
    errors = 0
    with bare(database) as (url, pid):
        sides = {True: (served.url, served.pid), False: (url, pid)}
        connections = {
            side: [await connect(where) for _ in fleets[side]] for side, (where, _) in sides.items()
        }
        for turn in range(turns + 1):
            for side in (True, False) if turn % 2 else (False, True):
                before = cpu_s(sides[side][1])
                took_s, bad = await _post(fleets[side], connections[side], rate_hz, seconds)
                await asyncio.sleep(0.2)
                errors += bad
                if turn:  # the first warms up
                    found[side].append(1e3 * (cpu_s(sides[side][1]) - before) / max(1, len(took_s)))
                    answers[side].append(Latency.of(took_s))
        for each in (*connections[True], *connections[False]):
            each.close()
    stream.close()
    return BesideBare(
        robots * rate_hz,
        *(tuple(found[True]), tuple(found[False])),
        *(tuple(answers[True]), tuple(answers[False])),
        errors=errors,
    )


async def _post(
    fleet: list[SimulatedRobot], connections: list[Connection], rate_hz: float, seconds: float
) -> tuple[list[float], int]:
    """Post changes on time; return after how many seconds each was accepted, and how many were not."""
    accepted: list[float] = []
    refused = 0
    every_s = 1 / (rate_hz * len(fleet))
    asked = round(seconds / every_s)
    began = time.perf_counter()
    for number in range(asked):
        due = began + number * every_s
        while (left := due - time.perf_counter()) > 0:
            await asyncio.sleep(left)
        robot = fleet[number % len(fleet)]
        wire = request("POST", robot.path, body(robot.change()))

        def answered(status: int, _: bytes, due: float = due) -> None:
            nonlocal refused
            if status == 200:
                accepted.append(time.perf_counter() - due)
            else:
                refused += 1

        connections[number % len(fleet)].send(wire, answered)
    async with asyncio.timeout(ANSWERS_S):
        while len(accepted) + refused < asked:
            await asyncio.sleep(0.01)
    return accepted, refused
