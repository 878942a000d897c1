"""How fast a stop stops: cancellations and the global stop at random moments of real repairs.

    everything off ──► repairs begin ──► a random moment: POST ──► nothing begins any more ──► repair ended
                                              │◄─── 0.1 s at most ────►│                         │
                                              │◄── 0.1 s, or 1 s where an action ran ───────────►│

It is asked once of the instance that owns the robots and once of another one, from which the request must
travel through the database. When a repair has ended is told by the event.

The robots have much to repair, on real boards: power by `robomend-board`, starts by programs that take time.

    device 0 … 3, a channel each ──► a driver each ──► a chain of six nodes, one after the other

Broken, everything is off and stopped: a repair of fourteen actions. The service's board link does the power,
its `process` executor the starts. The program of every other node of the chain ignores SIGTERM.

What acted, and when, is told by those who were acted upon: the boards' control ports and the programs' own
log, not by the service.
"""

from __future__ import annotations

import asyncio
import json
import random
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robomend_bench.parts import Figures
from robomend_bench.service.process import latency, served
from robomend_bench.service.wire import Connection, connect, follow, request

DEVICES = range(4)
CHAIN = range(6)

ACTS_S, STUBBORN_S = 0.15, 0.7
"""How long a start takes; a stubborn one, which ignores SIGTERM, longer than it is given after that."""

SHOWS_S = (0.05, 0.3)
"""From the end of a program until the robot reports that its node runs: nothing is being done meanwhile."""

PROGRAM = """#!/bin/sh
takes={acts_s}
case $1 in *stubborn*) trap '' TERM; takes={stubborn_s};; esac
echo "$(date +%s%N) begun $1" >> "$0.log"
sleep "$takes"
echo "$(date +%s%N) done $1" >> "$0.log"
"""


def write_program(folder: Path) -> Path:
    """Write what starts a node and the service's settings that name it; return the settings' file."""
    program = folder / "start"
    program.write_text(PROGRAM.format(acts_s=ACTS_S, stubborn_s=STUBBORN_S))
    program.chmod(0o700)
    settings = folder / "settings.yaml"
    settings.write_text(json.dumps({"programs": {"start": [str(program), "{0}"]}}))
    return settings


@dataclass(frozen=True, slots=True)
class Acted:
    """Something moved: a relay, or a program began or came to its end."""

    time_ns: int
    what: str


@dataclass
class Board:
    """An emulated board as a process, watched over its control port."""

    port: int
    control: asyncio.StreamWriter
    moved: list[Acted] = field(default_factory=list)

    def cut(self) -> None:
        """Take the power from every device."""
        for channel in DEVICES:
            self.control.write(json.dumps({"set": {"channel": channel, "on": False}}).encode() + b"\n")


@asynccontextmanager
async def board() -> AsyncIterator[Board]:
    """Run an emulator; it is gone afterwards."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-c", "from robomend_board.main import main; main()"),
        *("--port", "0", "--end-with-parent"),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C is for us, who end it
    )
    try:
        assert process.stdout is not None
        ready = json.loads(await process.stdout.readline())
        reader, writer = await asyncio.open_connection("127.0.0.1", ready["control_port"])
        running = Board(ready["port"], writer)
        writer.write(b'{"watch": true}\n')
        watching = asyncio.create_task(_watch(reader, running))
        yield running
        watching.cancel()
        writer.close()
    finally:
        process.kill()
        await process.wait()


async def _watch(reader: asyncio.StreamReader, running: Board) -> None:
    while line := await reader.readline():
        told = json.loads(line)
        if told.get("on"):
            running.moved.append(Acted(told["time_ns"], f"channel {told['channel']} on"))


class RepairedRobot:
    """One robot: it reports what its programs did, a while later."""

    def __init__(self, name: str, power: Board, programs_log: Path, seed: int) -> None:
        self.name = name
        self.board = power
        self.programs: list[Acted] = []
        self._log = programs_log
        self._read = 0
        self._random = random.Random(f"{name} {seed}")
        drivers = [f"{name}.driver{index}" for index in DEVICES]
        self.nodes = (*drivers, *(f"{name}.{_kind(index)}{index}" for index in CHAIN))
        self._reports: set[asyncio.Task[Any]] = set()

    def model(self) -> str:
        """Return its model."""
        parts: dict[str, Any] = {"robomend": 1, "name": self.name, "hardware": {}, "nodes": {}}
        for index in DEVICES:
            parts["hardware"][f"device{index}"] = {"channel": index}
            driver = {"drives": [f"device{index}"], "publishes": {f"driven{index}": []}}
            parts["nodes"][self.nodes[index]] = driver
        for index, node in enumerate(self.nodes[len(DEVICES) :]):
            rests_on = [f"made{index - 1}"] if index else [f"driven{other}" for other in DEVICES]
            parts["nodes"][node] = {"publishes": {f"made{index}": rests_on}}
        return json.dumps(parts)

    def config(self) -> dict[str, Any]:
        """Return its configuration: repaired at once when somebody asks, and not by itself."""
        start = {"executor": {"kind": "process", "options": {"program": "start"}}, "timeout_s": 10.0}
        return {
            "model": self.name,
            "policy": "auto",
            "hold_s": 86_400.0,
            "limits": {"attempts_per_hour": 100_000, "rounds": 5},
            "board": {"host": "127.0.0.1", "port": self.board.port, "rate_hz": 20, "protected": []},
            "actions": {"start_node": start},
        }

    @property
    def path(self) -> str:
        """Below /api/v1."""
        return f"/robots/{self.name}"

    async def break_down(self, connection: Connection) -> None:
        """Switch everything off, stop every node, and wait until the service has seen it."""
        for report in self._reports:
            report.cancel()
        self.board.cut()
        stopped = [f"not running({node})" for node in self.nodes]
        await connection.api("POST", f"{self.path}/observations", {"observations": stopped})
        off = {f"not on(device{index})" for index in DEVICES}
        while not off <= await self._seen(connection):
            await asyncio.sleep(0.02)

    async def _seen(self, connection: Connection) -> set[str]:
        answer = await connection.api("GET", f"{self.path}/observations")
        return {entry["literal"] for entry in answer["observations"]}

    async def live(self, connection: Connection) -> None:
        """Follow the programs and report, until cancelled."""
        try:
            while True:
                for acted in self._new():
                    self.programs.append(acted)
                    verb, node = acted.what.split()
                    if verb == "done":
                        self._reports.add(asyncio.create_task(self._report(connection, node)))
                await asyncio.sleep(0.01)
        finally:
            for report in self._reports:
                report.cancel()

    def _new(self) -> list[Acted]:
        if not self._log.exists():
            return []
        with self._log.open() as log:
            log.seek(self._read)
            text = log.read()
        whole = text[: text.rfind("\n") + 1]
        self._read += len(whole)
        lines = (line.split(" ", 1) for line in whole.splitlines())
        return [Acted(int(when), what) for when, what in lines if what.split()[1] in self.nodes]

    async def _report(self, connection: Connection, node: str) -> None:
        await asyncio.sleep(self._random.uniform(*SHOWS_S))
        await connection.api("POST", f"{self.path}/observations", {"observations": [f"running({node})"]})

    def acted_after(self, time_ns: int) -> list[Acted]:
        """Return what was done to this robot after a moment; the end of a program counts."""
        return [acted for acted in (*self.board.moved, *self.programs) if acted.time_ns > time_ns]


def _kind(index: int) -> str:
    return "stubborn" if index % 2 else "step"


@asynccontextmanager
async def robots(count: int, log: Path, seed: int) -> AsyncIterator[list[RepairedRobot]]:
    """Run so many robots' boards."""
    async with AsyncExitStack() as stack:
        boards = [await stack.enter_async_context(board()) for _ in range(count)]
        name = f"stop{time.time_ns() % 10_000}"
        yield [RepairedRobot(f"{name}.r{number}", power, log, seed) for number, power in enumerate(boards)]


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

    ended_s: list[float] = field(default_factory=list)  # from the request to the end of a repair
    begun_s: list[float] = field(default_factory=list)  # … to the beginning of an action, and what should not
    late: list[str] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)  # what is wrong on a machine of any speed

    def figures(self) -> Figures:
        """Return it as JSON values."""
        return {"ended": latency(self.ended_s), "begun": latency(self.begun_s), "late": self.late}


async def run_stops(arguments: Sequence[str], *, moments: int, count: int, seed: int) -> Figures:
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
                    results = {}
                    for asked_of, url in zip(ASKED_OF, (owner.url, other.url), strict=True):
                        async with _bench(owner.url, url, fleet, seed) as bench:
                            for way in WAYS:
                                results[f"{way}, asked of {asked_of}"] = await bench.run(way, moments)
    errors = [error for result in results.values() for error in result.errors]
    return {"errors": errors, **{name: result.figures() for name, result in results.items()}}


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

    async def run(self, way: str, moments: int) -> StopResult:
        """Let repairs begin and end them, until enough requests were made."""
        result = StopResult()
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
        connection.close()
        if found["state"] != "cancelled":
            result.errors.append(f"{repair} ended {found['state']}: {found['reason']}")
            return
        result.ended_s.append(ended_s)
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
