"""How fast a stop stops: cancellations and the global stop at random moments of real repairs.

    everything off ──► repairs begin ──► a random moment: POST ──► nothing begins any more ──► repair ended
                                              │◄─── 0.1 s at most ────►│                         │
                                              │◄── 0.1 s, or 1 s where an action ran ───────────►│

It is asked once of the instance that owns the robots and once of another one, from which the request must
travel through the database. An action ran if the audit log has it sent and without a result when the request
left, or sent after that. When a repair has ended is told by the event, what acted late by boards and
programs.
"""

from __future__ import annotations

import asyncio
import json
import random
import tempfile
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robomend_bench.service.process import Latency, served
from robomend_bench.service.repairing import RepairedRobot, robots, write_program
from robomend_bench.service.wire import Connection, connect, follow, request

NOTHING_BEGINS_S = 0.1
"""Goal: what begins later after a request than this is late."""

WITHIN_S = 4.0
"""A request comes between the beginning of the repairs and this: they take a little longer if left alone."""

ENDS_S = 30.0
"""What has not ended by then never will."""

WAYS = ("cancel", "stop")
ASKED_OF = ("the owner", "another instance")


@dataclass
class StopResult:
    """What came of one way to stop, asked of one instance."""

    way: str
    asked_of: str
    idle_s: list[float] = field(default_factory=list)  # to the end of repairs without a running action
    running_s: list[float] = field(default_factory=list)  # … with one
    begun_s: list[float] = field(default_factory=list)  # actions that began after the request, and when
    late: list[str] = field(default_factory=list)  # those of them that should not have
    errors: list[str] = field(default_factory=list)  # what is wrong on a machine of any speed

    def figures(self) -> dict[str, Any]:
        """Return it as JSON values."""
        return {
            "idle": _distribution(self.idle_s),
            "running": _distribution(self.running_s),
            "repairs": len(self.idle_s) + len(self.running_s),
            "begun_after_request": len(self.begun_s),
            "last_begun_ms": round(1e3 * max(self.begun_s, default=0.0), 1),
            "late": self.late,
            "errors": self.errors,
        }


def _distribution(seconds: Sequence[float]) -> dict[str, Any]:
    if not seconds:
        return {"count": 0, "p50_ms": None, "p90_ms": None, "max_ms": None}
    found = Latency.of(seconds)
    return {"count": found.count, "p50_ms": found.p50_ms, "p90_ms": found.p90_ms, "max_ms": found.max_ms}


async def run_stops(arguments: Sequence[str], *, moments: int, count: int, seed: int) -> list[StopResult]:
    """Ask `moments` times each way of each instance; `count` robots are under repair at a time."""
    with tempfile.TemporaryDirectory(prefix="robomend-bench-") as name:
        folder = Path(name)
        settings = write_program(folder)
        log = Path(f"{folder / 'start'}.log")
        wanted = [*arguments, "--config", str(settings)]
        async with robots(count, log, seed) as fleet:
            with served(wanted, folder, orderly=True) as owner:
                await _put(owner.url, fleet)
                with served(wanted, folder, orderly=True) as other:
                    results = []
                    for asked_of, url in zip(ASKED_OF, (owner.url, other.url), strict=True):
                        async with _bench(owner.url, url, fleet, seed) as bench:
                            results += [await bench.run(way, asked_of, moments) for way in WAYS]
    return results


async def _put(url: str, fleet: list[RepairedRobot]) -> None:
    connection = await connect(url)
    for robot in fleet:
        await connection.api("PUT", f"/models/{robot.name}", {"source": robot.model()})
        await connection.api("PUT", robot.path, robot.config())
    connection.close()


@asynccontextmanager
async def _bench(owner: str, asked: str, fleet: list[RepairedRobot], seed: int) -> AsyncIterator[_Bench]:
    bench = _Bench(owner, asked, fleet, random.Random(f"{asked} {seed}"))
    stream = await follow(owner, bench.event)
    living = [asyncio.create_task(robot.live(await connect(owner))) for robot in fleet]
    try:
        yield bench
    finally:
        for task in living:
            task.cancel()
        await asyncio.gather(*living, return_exceptions=True)
        stream.close()


class _Bench:
    """The measurement; `owner` and `asked` are URLs."""

    def __init__(self, owner: str, asked: str, fleet: list[RepairedRobot], chance: random.Random) -> None:
        self._owner = owner
        self._asked = asked
        self._fleet = fleet
        self._chance = chance
        self._ended: dict[str, float] = {}  # repair -> when the event said so, perf_counter
        self._news = asyncio.Event()

    def event(self, frame: bytes) -> None:
        """An event came."""
        if b"event: repair" not in frame:
            return
        [line] = [line for line in frame.splitlines() if line.startswith(b"data:")]
        repair = json.loads(line[5:])["data"]
        if repair.get("finished_ns") is not None:
            self._ended.setdefault(repair["id"], time.perf_counter())
            self._news.set()

    async def run(self, way: str, asked_of: str, moments: int) -> StopResult:
        """Let repairs begin and end them, until enough requests were made."""
        result = StopResult(way, asked_of)
        made = 0
        while made < moments:
            fleet = self._fleet[: moments - made] if way == "cancel" else self._fleet
            made += len(fleet) if way == "cancel" else 1
            repairs = await asyncio.gather(*map(self._begin, fleet))
            if way == "cancel":
                pairs = zip(fleet, repairs, strict=True)
                await asyncio.gather(*(self._cancel(robot, repair, result) for robot, repair in pairs))
            else:
                await self._stop(fleet, repairs, result)
        return result

    async def _begin(self, robot: RepairedRobot) -> str:
        connection = await connect(self._owner)
        await robot.break_down(connection)
        repair: str = (await connection.api("POST", f"{robot.path}/repairs", {"reason": "bench"}))["id"]
        connection.close()
        return repair

    async def _cancel(self, robot: RepairedRobot, repair: str, result: StopResult) -> None:
        connection = await connect(self._asked)
        await asyncio.sleep(self._chance.uniform(0.0, WITHIN_S))
        wire = request("POST", f"/api/v1/repairs/{repair}", b'{"decision": "cancel", "reason": "bench"}')
        sent, sent_ns = time.perf_counter(), time.time_ns()
        status, answer = await connection.ask(wire)
        connection.close()
        if status == 200:
            await self._judge(robot, repair, sent, sent_ns, result)
        elif status != 409:  # 409: it had ended by itself
            result.errors.append(f"{repair}: {status} {answer[:200]!r}")

    async def _stop(self, fleet: list[RepairedRobot], repairs: Sequence[str], result: StopResult) -> None:
        connection = await connect(self._asked)
        await asyncio.sleep(self._chance.uniform(0.0, WITHIN_S))
        wire = request("POST", "/api/v1/stop", b'{"reason": "bench"}')
        sent, sent_ns = time.perf_counter(), time.time_ns()
        status, answer = await connection.ask(wire)
        connection.close()  # an answer about the stop ends its connection
        if status not in (200, 202):  # 202: in force, and not on disk yet
            result.errors.append(f"stop: {status} {answer[:200]!r}")
        for robot, repair in zip(fleet, repairs, strict=True):
            if self._ended.get(repair, sent) >= sent:
                await self._judge(robot, repair, sent, sent_ns, result)
        connection = await connect(self._asked)
        await connection.api("DELETE", "/stop")
        connection.close()
        while await self._is_stopped():
            await asyncio.sleep(0.02)

    async def _is_stopped(self) -> bool:
        connection = await connect(self._owner)
        stopped: bool = (await connection.api("GET", "/stop"))["active"]
        connection.close()
        return stopped

    async def _judge(
        self, robot: RepairedRobot, repair: str, sent: float, sent_ns: int, result: StopResult
    ) -> None:
        """Wait for a repair's end, and note how long it took and what acted after the request."""
        deadline = sent + ENDS_S
        while repair not in self._ended:
            self._news.clear()
            if time.perf_counter() > deadline:
                result.errors.append(f"{repair}: not ended {ENDS_S:g} s after the request")
                return
            try:
                async with asyncio.timeout(0.5):
                    await self._news.wait()
            except TimeoutError:
                pass
        ended_s = self._ended[repair] - sent
        connection = await connect(self._owner)
        found = await connection.api("GET", f"/repairs/{repair}")
        running = await self._ran(connection, robot, sent_ns)
        connection.close()
        if found["state"] != "cancelled":
            result.errors.append(f"{repair} ended {found['state']}: {found['reason']}")
            return
        (result.running_s if running else result.idle_s).append(ended_s)
        await asyncio.sleep(NOTHING_BEGINS_S)  # what is wrong may still come
        for acted in robot.acted_after(sent_ns):
            after_s = (acted.time_ns - sent_ns) / 1e9
            begins = not acted.what.startswith("done")
            if begins:
                result.begun_s.append(after_s)
            if begins and after_s > NOTHING_BEGINS_S:
                result.late.append(f"{repair}: {acted.what} {after_s:.3f} s after the request")
            elif not begins and after_s > ended_s:
                result.errors.append(
                    f"{repair}: {acted.what} {after_s:.3f} s after the request, and was over"
                )

    async def _ran(self, connection: Connection, robot: RepairedRobot, at_ns: int) -> bool:
        """Return whether an action was under way at that moment, or was sent after it."""
        page = await connection.api("GET", f"/audit?robot={robot.name}&limit=200")
        open_ones: set[str] = set()
        for entry in reversed(page["items"]):
            if entry["time_ns"] > at_ns:
                if entry["action"] == "action.sent":
                    return True
            elif entry["action"] == "action.sent":
                open_ones.add(entry["subject"])
            elif entry["action"] == "action.result":
                open_ones.discard(entry["subject"])
            elif entry["action"] == "repair.create":
                open_ones.clear()
        return bool(open_ones)
