"""A whole agent under a robot of each kind: from its file to the service, which a double plays."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.clients.bridges.any_robot import ORIGINS, AnyRobot, any_robot
from tests.clients.running_agent import agent, config
from tests.clients.service_double import eventually, service_double


@pytest.fixture(params=ORIGINS)
def robot(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[AnyRobot]:
    with any_robot(request.param, tmp_path) as found:
        yield found


def test_a_killed_node_and_its_silent_topic_reach_the_service_with_their_evidence(
    robot: AnyRobot, tmp_path: Path
) -> None:
    laser = robot.node("hokuyo_node")
    laser.do("publish", topic="/scan", type="std_msgs/String", rate=10)
    laser.do("publish", topic="/motor", type="std_msgs/Float64", value={"data": 80.0}, rate=10)
    hot = {"kind": "property", "from": robot.origin, "source": "motor:data", "high": 60}
    sections: dict[str, Any] = {
        robot.origin: robot.section,
        "topics": {"scan": {"from": robot.origin, "first_s": 60}},
        "observers": {"hokuyo_node": robot.watched, "temperature": hot},
    }
    with service_double() as service, agent(config(tmp_path, service.url, {}, **sections)):
        good = {"ok(scan)": True, "running(hokuyo_node)": True, "ok(temperature)": False}
        eventually(lambda: good.items() <= service.holds().items(), "all", 60)
        laser.kill()
        bad = {"ok(scan)": False, "running(hokuyo_node)": False}
        eventually(lambda: bad.items() <= service.holds().items(), "both", 60)
        first = next(b for b in service.batches() if "not running(hokuyo_node)" in b["observations"])
        place = first["observations"].index("not running(hokuyo_node)")
        assert first["since"][place] >= first["onset"][place]
        assert not any("not running(hokuyo_node)" in b["observations"] for b in service.batches()[:1])
        atoms = {entry["atom"] for entry in service.polls[-1]["observes"]}
        assert atoms == {"ok(scan)", "running(hokuyo_node)", "ok(temperature)"}


def test_a_second_publisher_that_makes_a_topic_too_fast_is_named(robot: AnyRobot, tmp_path: Path) -> None:
    for name in ("odom_a", "odom_b"):
        robot.node(name).do("publish", topic="/odom", type="std_msgs/String", rate=10)
    odom = {"from": robot.origin, "first_s": 60, "rate_hz": 10, "tolerance_hz": 4}
    sections: dict[str, Any] = {robot.origin: robot.section, "topics": {"odom": odom}}
    with service_double() as service, agent(config(tmp_path, service.url, {}, **sections)):

        def read() -> dict[str, Any]:
            batches = [b for b in service.batches() if "not ok(odom)" in b["observations"]]
            newest = batches[-1] if batches else {"observations": [], "readings": []}
            found: dict[str, Any] = dict(zip(newest["observations"], newest["readings"], strict=True))
            return found.get("not ok(odom)") or {}

        limit = "10 ± 4; publishers: /odom_a, /odom_b"
        eventually(lambda: read().get("limit") == limit, "its publishers", 60)
        assert read()["symptom"] == "publishers"
        assert read()["value"] > 15


def test_a_number_that_is_none_is_told_once_with_its_source_and_changes_no_verdict(
    robot: AnyRobot, tmp_path: Path
) -> None:
    motor = robot.node("motor")
    topic = {"topic": "/motor", "type": "std_msgs/Float64"}
    motor.do("publish", value={"data": 40.0}, rate=20, **topic)
    cool = {"kind": "property", "from": robot.origin, "source": "motor:data", "high": 60, "lifetime_s": 600}
    sections: dict[str, Any] = {robot.origin: robot.section, "observers": {"cool": cool}}
    log = tmp_path / "agent.log"
    with service_double() as service, agent(config(tmp_path, service.url, {}, **sections)):
        eventually(lambda: service.holds().get("ok(cool)"), "ok(cool)", 60)
        motor.do("unpublish", topic="/motor")
        for value in (float("nan"), float("inf")):
            motor.do("publish", value={"data": value}, rate=20, **topic)
            eventually(lambda: "a sample of motor:data is no number" in log.read_text(), "a complaint", 60)
            motor.do("unpublish", topic="/motor")
        motor.do("publish", value={"data": 80.0}, rate=20, **topic)
        eventually(lambda: service.holds().get("ok(cool)") is False, "not ok(cool)", 60)
        assert not any("ok(cool)" in batch.get("unknown", ()) for batch in service.batches())
    assert log.read_text().count("a sample of motor:data is no number") == 1
