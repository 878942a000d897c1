"""A real service, a real agent, a robot with ROS 2 over DDS or zenoh: what it is told, and what it tells."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.api.test_process import served
from tests.clients.running_agent import agent, config
from tests.node_process import NodeProcess
from tests.ros2 import Ros2Robot
from tests.ros2 import robot as ros2_robot
from tests.waiting import until
from tests.zenoh_robot import ZenohRobot
from tests.zenoh_robot import robot as zenoh_robot

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


@contextmanager
def robot(over: str, folder: Path) -> Iterator[tuple[Ros2Robot | ZenohRobot, dict[str, Any]]]:
    """A robot, and the agent's section for it."""
    if over == "ros2":
        with ros2_robot(folder) as real:
            yield real, {"domain": real.domain, "discovery": "localhost"}
    else:
        with zenoh_robot(folder) as spoken:
            yield spoken, {"connect": [spoken.endpoint]}


@pytest.mark.parametrize("over", ["ros2", "zenoh"])
def test_a_robot_is_told_its_diagnosis_and_heard(over: str, tmp_path: Path) -> None:
    with robot(over, tmp_path) as (ros, keys), served(tmp_path) as (_, url), Client(url) as client:
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
            over: {**keys, "observations_s": 3},
            "topics": {"scan": {"from": over, "first_s": 60}},
            "observers": {"laser": {"kind": "node", "from": over, "preset": "ros2"}},
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
            until(lambda: obs().get("ok(map)") == "ROS /observations", "who said so", 60)
            until(lambda: obs().get("ok(scan)") == "agent onboard", "no echo of our own", 60)
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
        by = re.findall(r"/observations by (\S+): not understood: 'why\?' is no literal", log)
        assert by  # who publishes what is known a moment later, and then told under its own name
        assert len(by) == len(set(by))
