"""Overload: how fast answers are when twice as many changes come as the service can take.

First a closed loop shows what it can take; then a multiple of that is due, whatever the service does. A robot
has one request under way: what is due meanwhile is not sent, and counted. What is refused must be refused at
once (503), what is accepted must be quick, and nothing that was accepted may be lost. Beside it, a process of
its own asks for health and readiness and sets and lifts the stop (prober.py).
"""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass, field

from robomend_bench.service.companion import beside
from robomend_bench.service.durable import run_posts
from robomend_bench.service.fleet import differences, prepare
from robomend_bench.service.measure import Latency
from robomend_bench.service.robots import SimulatedRobot, body
from robomend_bench.service.wire import Connection, connect, request

LEFT_S = 30.0
"""How long what is under way at the end may take."""

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
class _Run:
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
    run, every_s = _Run(), 1 / (factor * closed.per_s)
    with beside("prober", url, str(LOOKS), told="") as operator:
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
