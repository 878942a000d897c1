"""A real service, a real agent, a real ROS 2 robot: what the robot is told, and what it tells."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tests.api.test_process import served
from tests.clients.running_agent import agent, config
from tests.node_process import NodeProcess
from tests.ros2 import robot
from tests.waiting import until

from robomend_client.rest.sync import Client

MODEL = {
    "robomend": 1,
    "name": "bot",
    "nodes": {"laser": {"publishes": {"scan": []}}, "mapper": {"publishes": {"map": ["scan"]}}},
    "properties": {"temp_cpu1": {}},
}
STRING = {"type": "std_msgs/String"}


def heard(watcher: NodeProcess, topic: str) -> list[Any]:
    return [line["value"] for line in tuple(watcher.heard) if line["heard"] == topic]


def test_a_robot_is_told_its_diagnosis_and_heard(tmp_path: Path) -> None:
    with robot(tmp_path) as ros, served(tmp_path) as (_, url), Client(url) as client:
        client.put_model("bot", json.dumps(MODEL))
        client.put_robot("tedusar", {"model": "bot", "policy": "observe"})
        laser, watcher = ros.node("laser"), ros.node("watcher")
        laser.do("publish", topic="/scan", rate=10, **STRING)
        for topic in ("/observations", "/diagnosis"):
            watcher.do("subscribe", topic=topic, **STRING)
        watcher.do("subscribe", topic="/diagnostics", type="diagnostic_msgs/DiagnosticArray")
        said = {"data": "~Ok(/temp_cpu1) and ok(map)"}
        watcher.do("publish", topic="/observations", value=said, rate=10, **STRING)
        laser.do("publish", topic="/observations", value={"data": "why?"}, rate=10, **STRING)
        sections: dict[str, Any] = {
            "ros2": {"domain": ros.domain, "discovery": "localhost", "observations_s": 3},
            "topics": {"scan": {"from": "ros2", "first_s": 60}},
            "observers": {"laser": {"kind": "node", "from": "ros2", "preset": "ros2"}},
        }

        def obs() -> dict[str, str]:
            return {
                one["literal"]: one["source"]
                for one in client.observations("tedusar")["observations"]
                if one["fresh"]
            }

        def blamed() -> list[list[str]]:
            told = [json.loads(message["data"]) for message in heard(watcher, "/diagnosis")]
            return [one["bad"] for one in told[-1]["diagnoses"]] if told else []

        def levels() -> dict[str, int]:
            arrays = heard(watcher, "/diagnostics")
            return {status["name"]: status["level"] for status in arrays[-1]["status"]} if arrays else {}

        with agent(config(tmp_path, url, {}, **sections)):
            until(lambda: {"not ok(temp_cpu1)", "ok(map)", "ok(scan)"} <= obs().keys(), "all sentences", 60)
            assert obs()["ok(map)"] == "ROS /observations"
            assert obs()["ok(scan)"] == "agent onboard"  # no echo of our own
            until(
                lambda: any("ok(scan)" in m["data"] for m in heard(watcher, "/observations")), "ok(scan)", 60
            )
            until(lambda: blamed() == [[]], "a diagnosis of a robot that is well", 60)
            until(lambda: levels() == {"robomend: laser": 0, "robomend: mapper": 0}, "all well", 60)
            watcher.do("hush", topic="/observations")
            until(lambda: "ok(map)" not in obs(), "what nobody repeats is unknown", 60)
            laser.kill()
            until(lambda: blamed() == [["laser"]], "the diagnosis", 60)
            until(lambda: levels().get("robomend: laser") == 2, "an error on /diagnostics", 60)
            (broken,) = (s for s in heard(watcher, "/diagnostics")[-1]["status"] if s["level"] == 2)
            assert broken["hardware_id"] == "laser"
            assert "laser" in {pair["key"]: pair["value"] for pair in broken["values"]}["diagnosis 1"]
        log = (tmp_path / "agent.log").read_text()
        assert log.count("not understood: 'why?' is no literal") == 1
