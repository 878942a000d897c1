"""Actions of the user's own, end to end: PDDL merged in, a program that carries them out, the real board.

The scanners are loads of an emulated power board; the robot sees only whether they are powered.
"""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from tests.repairs.robot import CONFIG, Robot, put_robot, running, service, the_repair
from tests.robomend_board.processes import running as emulator
from tests.waiting import eventually

from robomend.api.runtime import Runtime

pytestmark = pytest.mark.anyio

ACTIONS = Path(__file__).parents[2] / "examples" / "actions"

SCANNERS = """
robomend: 1
name: scanners
hardware:
  lidar: {channel: 3}
  lidar_b: {channel: 4}
nodes:
  lidar_node: {drives: [lidar], publishes: {scan: []}}
  mapping: {publishes: {map: [scan]}}
"""


WRITE = (sys.executable, "-c", "import sys; open(sys.argv[1], 'a').write(sys.argv[2] + '\\n')")
"""A program that notes its second argument in the file of the first."""


@dataclass
class ScannerRobot(Robot):
    """Two scanners on a board, one of which the driver reads: the one that `chosen` names last."""

    control_port: int = 0
    chosen: Path = Path()
    powered: dict[str, bool] = field(default_factory=dict)
    running: dict[str, bool] = field(default_factory=lambda: {"lidar_node": True, "mapping": True})
    read: str | None = "lidar"  # what the driver is connected to

    def do(self, name: str, parameter: str) -> None:
        self.running[parameter] = name == "start_node"
        if parameter == "lidar_node":
            wanted = self.chosen.read_text().split()[-1] if self.chosen.exists() else "lidar"
            self.read = wanted if self.running[parameter] and self.powered[wanted] else None

    def facts(self) -> dict[str, bool]:
        if self.read is not None and not self.powered[self.read]:
            self.read = None  # a connection that broke stays broken
        scan = self.running["lidar_node"] and self.read is not None
        facts = {f"running({node})": runs for node, runs in self.running.items()}
        return facts | {"ok(scan)": scan, "ok(map)": scan and self.running["mapping"]}

    async def settled(self) -> None:
        await eventually(lambda: self.powered, "the power of its devices")
        await super().settled()

    async def report_for_ever(self) -> None:
        """Follow the power as a device does, and report."""
        reader, writer = await asyncio.open_connection("127.0.0.1", self.control_port)
        try:
            while True:
                answer = await tell(reader, writer, {"status": True})
                channels = {one["channel"]: one["powered"] for one in answer["channels"]}
                self.powered = {"lidar": channels[3], "lidar_b": channels[4]}
                await self.report()
                await asyncio.sleep(0.05)
        finally:
            writer.close()


async def tell(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, request: dict[str, Any]
) -> dict[str, Any]:
    """Ask the control port."""
    writer.write(json.dumps(request).encode() + b"\n")
    answer: dict[str, Any] = json.loads(await reader.readline())
    assert answer["ok"], answer
    return answer


async def fault(port: int, name: str) -> None:
    """Bring a fault of the first scanner about."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    await tell(reader, writer, {"fault": name, "channel": 3})
    writer.close()


def by_agent(*names: str) -> dict[str, Any]:
    return {name: {"timeout_s": 2.0, "effect_timeout_s": 1.0} for name in names}


@asynccontextmanager
async def scanners(runtime: Runtime, board: Any, chosen: Path) -> AsyncIterator[ScannerRobot]:
    """Robot r1 with two scanners on an emulated board."""
    switch = {"executor": {"kind": "process", "options": {"program": "choose-scanner"}}, "timeout_s": 5.0}
    config = {
        **CONFIG,
        "model": "scanners",
        "board": {"host": "127.0.0.1", "port": board.port, "rate_hz": 20, "protected": []},
        "observed": ["on(lidar)", "on(lidar_b)", "running(lidar_node)", "ok(scan)", "ok(map)"],
        "domain": (ACTIONS / "switch_to_spare.pddl").read_text(),
        "actions": {
            **by_agent("start_node", "stop_node", "power_up", "shutdown"),
            "switch_to_spare": {**switch, "idempotent": True},
        },
    }
    await put_robot(runtime, SCANNERS, **config)
    robot = ScannerRobot(runtime.repairs, runtime.robots, control_port=board.control_port, chosen=chosen)
    async with running(robot):
        yield robot


async def test_a_scanner_that_its_driver_s_restart_does_not_bring_back_is_replaced_by_its_spare(
    tmp_path: Path,
) -> None:
    chosen = tmp_path / "chosen"
    programs = {"choose-scanner": (*WRITE, str(chosen), "{1}")}
    with emulator("--on", "3,4") as board:
        async with (
            service(tmp_path, programs=programs) as runtime,
            scanners(runtime, board, chosen) as robot,
        ):
            await robot.settled()
            await fault(board.control_port, "open")
            repair = await the_repair(runtime, timeout_s=60)
    done = [
        [step["text"] for step in one["plan"] if step["state"] in {"done", "failed"}]
        for one in repair["rounds"]
    ]
    assert repair["state"] == "repaired", repair["reason"]
    assert "unconfirmed" not in repair["reason"]  # the board went on saying that both are on
    assert chosen.read_text() == "lidar_b\n"
    assert robot.read == "lidar_b"
    assert done[-1] == [
        "switch_to_spare(lidar, lidar_b)",
        "stop_node(lidar_node)",
        "start_node(lidar_node)",
    ]
    # The cheaper driver's restart first, once; a power cycle would cost nearly as much as the spare, and
    # could not help against a broken scanner.
    assert done[0] == ["stop_node(lidar_node)", "start_node(lidar_node)"]
    assert len(done) == 2
