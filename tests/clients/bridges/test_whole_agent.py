"""A whole agent under a robot of each kind: from its file to the service, which a double plays."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest
from tests.clients.bridges.any_robot import AnyRobot
from tests.clients.running_agent import agent, config
from tests.clients.service_double import ServiceDouble, eventually
from tests.wrong_clock import WrongClock


def test_nodes_and_topics_reach_the_service_with_their_evidence(
    robot: AnyRobot, service: ServiceDouble, tmp_path: Path
) -> None:
    origin = {"from": robot.origin}
    laser, other = robot.node("hokuyo_node"), robot.node("other")
    string = {"type": "std_msgs/String", "rate": 10}
    motor = {"topic": "/motor", "type": "std_msgs/Float64", "rate": 20}
    laser.do("publish", topic="/scan", **string)
    for node in (laser, other):
        node.do("publish", topic="/odom", **string)
    other.do("publish", value={"data": 40.0}, **motor)
    cool = {"kind": "property", "source": "motor:data", "high": 60, "lifetime_s": 600, **origin}
    sections: dict[str, Any] = {
        robot.origin: robot.section,
        "topics": {
            "scan": {"first_s": 60, **origin},
            "odom": {"first_s": 60, "rate_hz": 10, "tolerance_hz": 4, **origin},
        },
        "observers": {"hokuyo_node": robot.watched, "cool": cool},
    }
    log = tmp_path / "agent.log"
    no_number = "a sample of motor:data is no number"

    def fast() -> dict[str, Any]:
        batches = [b for b in service.batches() if "not ok(odom)" in b["observations"]]
        newest = batches[-1] if batches else {"observations": [], "readings": []}
        found: dict[str, Any] = dict(zip(newest["observations"], newest["readings"], strict=True))
        return found.get("not ok(odom)") or {}

    with agent(config(tmp_path, service.url, {}, **sections)):
        good = {"ok(scan)": True, "running(hokuyo_node)": True, "ok(cool)": True, "ok(odom)": False}
        eventually(lambda: good.items() <= service.holds().items(), "all", 60)
        limit = "10 ± 4; publishers: /hokuyo_node, /other"
        eventually(lambda: fast().get("limit") == limit and fast()["value"] > 15, "both publishers", 60)
        assert fast()["symptom"] == "publishers"
        other.do("unpublish", topic="/motor")
        for value in (float("nan"), float("inf")):
            other.do("publish", value={"data": value}, **motor)
            eventually(lambda: no_number in log.read_text(), "a complaint", 60)
            other.do("unpublish", topic="/motor")
        assert not any("not ok(cool)" in batch["observations"] for batch in service.batches())
        other.do("publish", value={"data": 80.0}, **motor)
        eventually(lambda: service.holds().get("ok(cool)") is False, "not ok(cool)", 60)
        laser.kill()
        bad = {"ok(scan)": False, "running(hokuyo_node)": False}
        eventually(lambda: bad.items() <= service.holds().items(), "both", 60)
        first = next(b for b in service.batches() if "not running(hokuyo_node)" in b["observations"])
        place = first["observations"].index("not running(hokuyo_node)")
        assert first["since"][place] >= first["onset"][place]
        assert not any("not running(hokuyo_node)" in b["observations"] for b in service.batches()[:1])
        assert {entry["atom"] for entry in service.polls[-1]["observes"]} == good.keys()
    assert log.read_text().count(no_number) == 1


# --- clocks that jump ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "robot", ["ros1", "ros2", pytest.param("zenoh", marks=pytest.mark.long)], indirect=True
)
def test_the_robots_own_time_plays_no_part_wherever_it_jumps(
    robot: AnyRobot, service: ServiceDouble, tmp_path: Path
) -> None:
    """It jumps either way, and stands still."""
    origin = robot.origin
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
        for seconds in (4600, 3):  # an hour ahead, and a simulation that was reset
            robots_time_is(seconds)
            wanted = len(service.batches()) + 3
            eventually(lambda: len(service.batches()) >= wanted, "the next reports", 60)  # noqa: B023  # at once
            eventually(lambda: well.items() <= service.holds().items(), "all well", 60)
    told = [literal for batch in service.batches() for literal in batch["observations"]]
    assert "not ok(scan)" not in told[told.index("ok(scan)") :]
    assert "not running(laser)" not in told[told.index("running(laser)") :]


def test_a_clock_that_is_set_stops_no_node_and_silences_no_topic(
    robot: AnyRobot, service: ServiceDouble, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The agent's, or that of the robot's nodes where messages bear their publishers' stamps."""
    clock, is_robots = WrongClock(tmp_path), robot.origin != "ros1"
    with monkeypatch.context() as there:
        for name, value in clock.native.items() if is_robots else ():
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
    environment = None if is_robots else clock.environment
    with agent(config(tmp_path, service.url, {}, **sections), environment):
        eventually(lambda: well.items() <= service.signs().items(), "all well", 120)
        begun = len(service.batches())

        def since_ns() -> dict[str, int]:
            """Return since when each literal holds."""
            found: dict[str, int] = {}
            for batch in service.batches()[begun:]:
                found |= dict(zip(batch["observations"], batch.get("since", ()), strict=True))
            return found

        for ahead_s in (600, -600):
            clock.set(ahead_s)
            ours_ns = time.time_ns() + (0 if is_robots else ahead_s * 10**9)
            young_ns = max(ours_ns, *since_ns().values(), 0) + 10**9
            eventually(
                lambda: all(since_ns().get(name, 0) > young_ns for name in well),  # noqa: B023  # at once
                f"young evidence of all, {ahead_s:+} s: {since_ns()}",
                60,
            )
        told = [literal for batch in service.batches()[begun:] for literal in batch["observations"]]
        assert set(told) == set(well)
        laser.kill()
        eventually(lambda: service.signs()["running(laser)"] is False, "that it is gone", 60)
    times = [batch["time"] for batch in service.batches()]
    assert times == sorted(times)
    assert all(
        since_ns <= batch["time"] for batch in service.batches() for since_ns in batch.get("since", ())
    )
