"""Robots with much to repair, on real boards: power by `robomend-board`, starts by programs that take time.

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
import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robomend_bench.service.wire import Connection

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
