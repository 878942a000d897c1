"""A clock that is set while a bridge watches a robot: the agent's, or that of the robot's nodes."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest
from tests.clients.bridges.any_robot import AnyRobot
from tests.clients.running_agent import agent, config
from tests.clients.service_double import ServiceDouble, eventually
from tests.wrong_clock import WrongClock

STAMPED = ("ros2", "zenoh")
"""Where messages bear their publishers' stamps."""


def test_a_clock_that_is_set_stops_no_node_and_silences_no_topic(
    robot: AnyRobot, service: ServiceDouble, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clocks = {}
    for whose in ("agent", "robot") if robot.origin in STAMPED else ("agent",):
        (tmp_path / whose).mkdir()
        clocks[whose] = WrongClock(tmp_path / whose)
    with monkeypatch.context() as there:
        for name, value in clocks["robot"].native.items() if "robot" in clocks else ():
            there.setenv(name, value)
        laser = robot.node("laser")
    laser.do("publish", topic="/scan", type="std_msgs/String", rate=10)
    # On a busy computer messages are late, and come all at once.
    calm = {"first_s": 60, "tolerance_hz": 9.9, "tolerance_above_hz": 10_000, "silence_s": 10}
    sections: dict[str, Any] = {
        robot.origin: robot.section,
        "topics": {"scan": {"from": robot.origin, **calm}},
        "observers": {"laser": robot.watched},
    }
    well = {"ok(scan)": True, "running(laser)": True}
    with agent(config(tmp_path, service.url, {}, **sections), clocks["agent"].environment):
        eventually(lambda: well.items() <= service.signs().items(), "all well", 120)
        begun = len(service.batches())

        def since_ns() -> dict[str, int]:
            """Return since when each literal holds."""
            found: dict[str, int] = {}
            for batch in service.batches()[begun:]:
                found |= dict(zip(batch["observations"], batch.get("since", ()), strict=True))
            return found

        for whose, clock in reversed(clocks.items()):
            for ahead_s in (600, -600, 0):  # one is wrong at a time
                clock.set(ahead_s)
                ours_ns = time.time_ns() + (ahead_s * 10**9 if whose == "agent" else 0)
                young_ns = max(ours_ns, *since_ns().values(), 0) + 10**9
                eventually(
                    lambda: all(since_ns().get(name, 0) > young_ns for name in well),  # noqa: B023  # at once
                    f"young evidence of all, {whose} {ahead_s:+} s: {since_ns()}",
                    60,
                )
        told = [literal for batch in service.batches()[begun:] for literal in batch["observations"]]
        assert set(told) == set(well)
        laser.kill()
        eventually(lambda: service.signs()["running(laser)"] is False, "that it is gone", 60)
