"""A real service, a real agent, a real robot: what it offers is asked for, seen to help, and nothing else."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.api.test_process import served
from tests.clients.bridges.ros1.test_asking import SWITCH, offered
from tests.clients.running_agent import agent, config
from tests.ros1 import robot as ros1_robot
from tests.ros2 import robot as ros2_robot
from tests.waiting import until

from robomend_client.bridges.ros2.dds import Dds, configuration
from robomend_client.bridges.ros2.discovered import Discovered
from robomend_client.rest.sync import Client

TRIGGER = "std_srvs/srv/Trigger"


class Wire:
    """Who can send requests to which services of a domain: who does must have a writer for them before.

    It reads none of them: a server with another reader beside it counts as not there.
    """

    def __init__(self, dds: Dds) -> None:
        self._dds = dds
        self._found = Discovered(dds.key)
        self._end = threading.Event()
        self.offered: set[str] = set()
        self.asked: set[str] = set()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        while not self._end.wait(0.02):
            self._dds.discover(self._found)
            for one in tuple(self._found.endpoints.values()):
                if one.topic.startswith("rq/"):
                    (self.asked if one.writes else self.offered).add(one.topic)

    def close(self) -> None:
        self._end.set()
        self._thread.join()
        self._dds.close()


@contextmanager
def wire(domain: int) -> Iterator[Wire]:
    found = Wire(Dds(domain, configuration(os.environ, True, ())))
    try:
        yield found
    finally:
        found.close()


def request(service: str) -> str:
    return f"rq/{service}Request"


def publishing(topic: str) -> dict[str, Any]:
    return {"do": "publish", "topic": topic, "type": "std_msgs/String", "rate": 10}


NODES = {"planner": "path", "camera": "image", "driver": "scan"}

MODEL = {
    "robomend": 1,
    "name": "bot",
    "nodes": {node: {"publishes": {topic: []}, "restartable": False} for node, topic in NODES.items()},
    "remedies": {
        "clear": {"mends": "planner"},
        "set_fps(camera, low)": {"mends": "camera"},
        "bring_up": {"mends": "driver"},
    },
}


def repair_of(client: Client, robot: str) -> dict[str, Any]:
    repairs = client.repairs(robot)["items"]
    return dict(repairs[0]) if repairs else {"state": "none"}


def test_services_parameters_and_lifecycles_of_ros_2_repair_it_and_nothing_else_is_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with (
        ros2_robot(tmp_path) as ros,
        served(tmp_path) as (_, url),
        Client(url) as client,
        wire(ros.domain) as seen,
    ):
        monkeypatch.setenv("ROBOMEND_RCLPY_PYTHON", str(ros.python))
        planner, camera, driver = (ros.node(name) for name in NODES)
        answer = {"success": True, "message": "cleared"}
        planner.do("offer", name="/clear", type=TRIGGER, answer=answer, then=publishing("/path"))
        planner.do("offer", name="/reset", type=TRIGGER, answer=answer)  # nobody is configured for it
        camera.do("declare", name="fps", value=90, then=publishing("/image"))
        driver.do("lifecycle", name="managed", then=publishing("/scan"))
        driver.do("lifecycle", name="other")
        until(lambda: request("clear") in seen.offered, "the services on the wire", 60)
        assert not seen.asked
        client.put_model("bot", json.dumps(MODEL))
        observed = [f"ok({topic})" for topic in NODES.values()]
        client.put_robot("tedusar", {"model": "bot", "policy": "auto", "observed": observed})
        sections: dict[str, Any] = {
            "ros2": {"domain": ros.domain, "discovery": "localhost"},
            "topics": {
                topic: {"from": "ros2", "rate_hz": 10, "tolerance_hz": 8, "first_s": 1}
                for topic in NODES.values()
            },
            "observers": {"nodes": {"kind": "node", "from": "ros2", "preset": "ros2", "nodes": list(NODES)}},
            "actions": {
                "clear": {
                    "kind": "ros2_service", "services": {"planner": "/clear"}, "type": TRIGGER,
                    "timeout_s": 120,
                },
                "set_fps": {
                    "kind": "ros2_parameter", "nodes": {"camera": "/camera"}, "parameter": "fps",
                    "values": {"low": 5, "high": 60}, "timeout_s": 120,
                },
                "bring_up": {
                    "kind": "lifecycle", "nodes": {"driver": "/managed"}, "transition": "restart",
                    "timeout_s": 120,
                },
            },
        }  # fmt: skip
        with agent(config(tmp_path, url, {}, **sections)):
            until(lambda: repair_of(client, "tedusar")["state"] == "repaired", "the repair", 280)
            repair = repair_of(client, "tedusar")
            began = time.monotonic()
            until(lambda: time.monotonic() - began > 2, "what might follow")
        acts = {step["text"] for one in repair["rounds"] for step in one["plan"]}
        assert acts == {"clear(planner)", "set_fps(camera, low)", "bring_up(driver)"}
        shown = {literal for one in repair["rounds"] for step in one["plan"] for literal in step["seen"]}
        assert shown >= set(observed)
        assert [line["value"] for line in camera.heard] == [5]
        assert seen.asked  # on a busy computer some come and go between two looks at who is there
        assert seen.asked <= {
            request("clear"),
            request("camera/get_parameters"),
            request("camera/set_parameters"),
            request("managed/get_state"),
            request("managed/change_state"),
        }
        assert [line["heard"] for line in planner.heard] == ["/clear"]  # once, and /reset never
        assert request("reset") in seen.offered


def test_a_step_of_a_parameter_of_ros_2_is_the_act_of_a_variant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = {
        "robomend": 1,
        "name": "bot",
        "nodes": {"camera": {}},
        "properties": ["bright"],
        "functions": {
            "picture": {
                "variants": {
                    "fast": {"when": "ok(bright)", "do": ["step_fps(camera, more)"]},
                    "slow": {"do": ["step_fps(camera, less)"]},
                },
                "adapt": "auto",
            }
        },
    }
    with ros2_robot(tmp_path) as ros, served(tmp_path) as (_, url), Client(url) as client:
        monkeypatch.setenv("ROBOMEND_RCLPY_PYTHON", str(ros.python))
        camera = ros.node("camera")
        level = {"do": "publish", "topic": "/level", "type": "std_msgs/Float64", "rate": 10}
        camera.do("declare", name="fps", value=40, then={**level, "value": {"data": 1.0}})
        client.put_model("bot", json.dumps(model))
        client.put_robot("tedusar", {"model": "bot", "policy": "auto", "observed": ["running(camera)"]})
        sections: dict[str, Any] = {
            "ros2": {"domain": ros.domain, "discovery": "localhost"},
            "observers": {
                "nodes": {"kind": "node", "from": "ros2", "preset": "ros2", "nodes": ["camera"]},
                "active(picture,slow)": {
                    "kind": "property", "from": "ros2", "source": "level:data", "low": 0.5, "interval_s": 0.2,
                },
            },
            "actions": {
                "step_fps": {
                    "kind": "ros2_parameter", "nodes": {"camera": "/camera"}, "parameter": "fps",
                    "steps": {"more": 30, "less": -30}, "least": 15, "most": 60, "timeout_s": 120,
                }
            },
        }  # fmt: skip
        with agent(config(tmp_path, url, {}, **sections)):
            client.observe("tedusar", ["active(picture, fast)", "not ok(bright)"], source="test")

            def changed() -> bool:
                return [one["state"] for one in client.changes("tedusar")["items"]] == ["changed"]

            until(changed, "the change", 200)
            (change,) = client.changes("tedusar")["items"]
        assert [step["text"] for step in change["plan"]] == ["step_fps(camera, less)"]
        assert [line["value"] for line in camera.heard] == [15]  # 40 less 30, and not below the least
        assert client.repairs("tedusar")["items"] == []


def test_services_and_a_controller_manager_of_ros_1_repair_it_and_nothing_else_is_asked(
    tmp_path: Path,
) -> None:
    switch = "controller_manager_msgs/SwitchController"
    model = {
        "robomend": 1,
        "name": "bot",
        "nodes": {
            "laser": {"publishes": {"scan": []}, "restartable": False},
            "manager": {"publishes": {"joint_states": []}, "restartable": False},
        },
        "remedies": {"reset": {"mends": "laser"}, "switch(manager, slow)": {"mends": "manager"}},
    }
    with ros1_robot(tmp_path) as ros, served(tmp_path) as (_, url), Client(url) as client:
        laser, manager = ros.node("laser"), ros.node("manager")
        answer = {"answer": {"success": True, "message": "was reset"}}
        laser.do("offer", name="/reset", then=publishing("/scan"), **offered("std_srvs/Trigger", **answer))
        laser.do("offer", name="/shutdown", **offered("std_srvs/Trigger", **answer))
        switches = offered(switch, answer={"ok": True})
        manager.do("offer", name="/manager/switch", then=publishing("/joint_states"), **switches)
        client.put_model("bot", json.dumps(model))
        observed = ["ok(scan)", "ok(joint_states)"]
        client.put_robot("tedusar", {"model": "bot", "policy": "auto", "observed": observed})
        expected = {"from": "ros1", "rate_hz": 10, "tolerance_hz": 8, "first_s": 1}
        sections: dict[str, Any] = {
            "ros1": {"master": ros.master.uri},
            "topics": {"scan": expected, "joint_states": expected},
            "observers": {
                "nodes": {"kind": "node", "from": "ros1", "preset": "ros1", "nodes": ["laser", "manager"]}
            },
            "actions": {
                "reset": {
                    "kind": "ros1_service", "services": {"laser": "/reset"}, "type": "std_srvs/Trigger"
                },
                "switch": {
                    "kind": "ros1_service", "services": {"manager": "/manager/switch"}, "type": switch,
                    "request": {"start_controllers": "{to}", "strictness": 2},
                    "parameters": {"to": ["slow", "fast"]}, "definition": SWITCH,
                },
            },
        }  # fmt: skip
        with agent(config(tmp_path, url, {}, **sections)):
            until(lambda: repair_of(client, "tedusar")["state"] == "repaired", "the repair", 100)
            repair = repair_of(client, "tedusar")
        acts = {step["text"] for one in repair["rounds"] for step in one["plan"]}
        assert acts == {"reset(laser)", "switch(manager, slow)"}
        shown = {literal for one in repair["rounds"] for step in one["plan"] for literal in step["seen"]}
        assert shown >= set(observed)
        assert [line["heard"] for line in laser.heard] == ["/reset"]
        assert [line["value"]["start_controllers"] for line in manager.heard] == [["slow"]]
