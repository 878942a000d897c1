"""A robot that lives by /clock: its time jumps either way, and stands still."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tests.clients.bridges.any_robot import ORIGINS, any_robot
from tests.clients.running_agent import agent, config
from tests.clients.service_double import eventually, service_double


@pytest.mark.parametrize("origin", ORIGINS)
def test_the_robots_own_time_plays_no_part_wherever_it_jumps(origin: str, tmp_path: Path) -> None:
    with any_robot(origin, tmp_path) as robot, service_double() as service:
        node = robot.node
        clock = node("clock")
        if origin == "ros1":
            clock.do("simulated")  # before others begin
        laser, watcher = node("laser"), node("watcher")
        if origin != "ros1":
            laser.do("simulated")
        laser.do("publish", topic="/scan", type="std_msgs/Header", stamped=True, rate=10)
        watcher.do("subscribe", topic="/scan", type="std_msgs/Header")

        def robots_time_is(seconds: int) -> None:
            value = {"clock": {"sec": seconds} if origin == "zenoh" else seconds}
            clock.do("publish", topic="/clock", type="rosgraph_msgs/Clock", value=value, rate=20)

            def stamped() -> bool:
                stamp = watcher.heard[-1]["value"]["stamp"] if watcher.heard else {}
                return int(seconds) in (stamp.get("secs"), stamp.get("sec"))

            eventually(stamped, f"headers of {seconds:g} s", 60)
            clock.do("hush", topic="/clock")  # it stands still then

        sections: dict[str, Any] = {
            origin: robot.section,
            "topics": {"scan": {"from": origin, "first_s": 60, "tolerance_hz": 8, "silence_s": 10}},
            "observers": {
                "laser": robot.watched,
                "time": {"kind": "qualitative", "from": origin, "source": "scan:stamp.sec"},
            },
        }
        robots_time_is(1000)
        with agent(config(tmp_path, service.url, {}, **sections)):
            well = {"ok(scan)": True, "running(laser)": True, "const(time)": True}
            eventually(lambda: well.items() <= service.holds().items(), "all well", 60)
            for seconds in (4600, 3, 5):  # an hour ahead, a simulation that was reset, on
                robots_time_is(seconds)
                wanted = len(service.batches()) + 3
                eventually(lambda: len(service.batches()) >= wanted, "the next reports", 60)  # noqa: B023  # at once
                eventually(lambda: well.items() <= service.holds().items(), "all well", 60)
    told = [literal for batch in service.batches() for literal in batch["observations"]]
    assert "not ok(scan)" not in told[told.index("ok(scan)") :]
    assert "not running(laser)" not in told[told.index("running(laser)") :]
