"""A robot in real time, on a clock that the test turns; nobody is there to take its reports."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from tests.robomend_bench.faults.small import ROBOT

from robomend_bench.faults.classes import Scenario
from robomend_bench.faults.condition import Act
from robomend_bench.faults.kinds import Fault
from robomend_bench.faults.live import LiveRobot, knows
from robomend_bench.faults.observing import PRESETS
from robomend_bench.faults.record import Record, Trial
from robomend_bench.faults.robot import Robot, find_robot
from robomend_client.rest.asynchronous import AsyncClient

NOBODY = "http://127.0.0.1:9"


class Turned:
    """A live robot and its clock."""

    def __init__(self, folder: Path, clients: tuple[AsyncClient, AsyncClient]) -> None:
        self.now_s = 0.0
        self.record = Record(Trial("small", "jitter", 1, 1), "fast")
        robot = Robot("small", "", ROBOT)
        self.live = LiveRobot(
            robot, Scenario(), self.record, PRESETS["fast"], "r", clients, folder, lambda: self.now_s
        )

    def run(self, until_s: float, late_s: float = 0.0) -> None:
        while self.now_s < until_s:
            self.now_s = round(self.now_s + 0.01, 3)
            self.live.tick(self.now_s, late_s)

    def said(self, since_s: float) -> set[str]:
        return {str(each) for at_s, literals in self.record.said if at_s > since_s for each in literals}


@asynccontextmanager
async def turned(folder: Path) -> AsyncIterator[Turned]:
    async with AsyncClient(NOBODY) as reports, AsyncClient(NOBODY) as orders:
        found = Turned(folder, (reports, orders))
        await found.live.open()
        for agent in found.live.agents:
            found.live.start_agent(agent)
        try:
            yield found
        finally:
            await found.live.close()


def play(folder: Path, steps: str) -> Turned:
    """Run a robot for three seconds and then what the steps say; return it."""

    async def work() -> Turned:
        async with turned(folder) as found:
            live = found.live
            found.run(3.0)
            match steps:
                case "fault":
                    live.plant(Fault("mapper", "dead"))
                    found.run(6.0)
                case "late":
                    found.run(5.0, late_s=0.4)
                case "held up":
                    live.hold_up(None)
                    found.run(5.0)
                    found.record.notes.append((found.now_s, ", ".join(sorted(found.said(3.0)))))
                    live.resume(None)
                    found.run(5.2)
                case "restart":
                    await live.stop_agent(live.agents[0])
                    found.run(8.0)
                    live.start_agent(live.agents[0])
                    found.run(12.0)
                case "off":
                    live.plant(Fault("lidar", "off for ever"))
                    found.run(4.0)
            return found

    return asyncio.run(work())


def test_observers_say_what_happens_when_it_happens(tmp_path: Path) -> None:
    found = play(tmp_path, "fault")
    assert "ok(map)" in found.said(0.0)
    assert found.said(3.0) == {"not running(mapper)", "not ok(map)", "not ok(path)"}
    assert [(at_s, str(fault)) for at_s, fault in found.record.faults] == [(3.0, "mapper dead")]


def test_a_late_bench_is_noted_and_makes_nothing_silent(tmp_path: Path) -> None:
    found = play(tmp_path, "late")
    assert found.record.late_s == 0.4
    assert found.said(3.0) == set()


def test_an_agent_that_is_held_up_takes_nothing_of_it_for_news(tmp_path: Path) -> None:
    found = play(tmp_path, "held up")
    assert found.record.notes == [(5.0, "")]
    assert found.said(5.0) == set()  # neither its own silence, nor the messages that come all at once


def test_an_agent_that_is_restarted_begins_anew(tmp_path: Path) -> None:
    found = play(tmp_path, "restart")
    assert not [at_s for at_s, _ in found.record.said if 3.0 < at_s <= 8.0]
    assert not [literal for literal in found.said(8.0) if literal.startswith("not")]


def test_a_relay_that_opens_is_the_board_s_and_the_body_s(tmp_path: Path) -> None:
    found = play(tmp_path, "off")
    assert not found.live.body.on("lidar")
    assert "not ok(scan)" in found.said(3.0)
    assert found.record.acts == []  # what the bench does to the board is nobody's act


@pytest.mark.parametrize("host", ["mind", "motion", "vision"])
def test_each_host_does_what_hangs_on_it(host: str) -> None:
    robot = find_robot("humanoid")
    here = knows(robot, host)
    for node in robot.anatomy.nodes.values():
        assert (Act("start_node", (node.name,)) in here) == (node.host == host)
    for device in robot.anatomy.devices.values():
        assert (Act("power_up", (device.name,)) in here) == (device.host == host)
