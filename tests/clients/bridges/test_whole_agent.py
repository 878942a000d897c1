"""A whole agent under a robot of each kind: from its file to the service, which a double plays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.clients.bridges.any_robot import AnyRobot
from tests.clients.running_agent import agent, config
from tests.clients.service_double import ServiceDouble, eventually


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
        eventually(lambda: fast().get("limit") == limit, "its publishers", 60)
        assert (fast()["symptom"], fast()["value"] > 15) == ("publishers", True)
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
