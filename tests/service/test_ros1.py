"""A real service, a real agent, a real ROS 1 robot: what the robot is told, and what it tells."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.api.test_process import served
from tests.clients.bridges.ros1.test_actions import REJECTED, REPAIR, SUCCEEDED
from tests.clients.running_agent import agent, config
from tests.robomend_board.processes import running as emulator
from tests.ros1 import Robot, RosNode, robot
from tests.waiting import until

from robomend_client.rest.sync import Client

MODEL = {
    "robomend": 1,
    "name": "bot",
    "nodes": {"laser": {"publishes": {"scan": []}}, "mapper": {"publishes": {"map": ["scan"]}}},
    "hardware": {"lamp": {"channel": 3}},
    "properties": {"temp_cpu1": {}},
}

# As in the published system: its subscribers compare the md5 sums of these.
OBSERVATIONS = {
    "type": "tug_ist_diagnosis_msgs/Observations",
    "definition": "float32 out_time\nstring[] obs\n",
}
DIAGNOSIS = {
    "type": "tug_ist_diagnosis_msgs/Diagnosis",
    "definition": "float32 o_time\nDiagnosisResults[] diag\n"
    + "=" * 80
    + "\nMSG: tug_ist_diagnosis_msgs/DiagnosisResults\nstring[] good\nstring[] bad\n",
}
BOARD = {
    "type": "tug_ist_diagnosis_msgs/DBoardMeasurments",
    "definition": "float32 o_time\nChannel[] channel\n"
    + "=" * 80
    + "\nMSG: tug_ist_diagnosis_msgs/Channel\nint32 id\nstring dev_connected\nint32 status\n"
    + "float32 current\nfloat32 voltage\n",
}
MODEL_ACTION = {
    "type": REPAIR["type"].replace("DiagnosisRepair", "SystemModel"),
    "definition": REPAIR["definition"]
    .replace("DiagnosisRepair", "SystemModel")
    .replace("string[] parameter\n", "int32 goal\n")
    .replace("int32 result\n", "string ab\nstring nab\nstring neg_prefix\nstring[] rules\nstring[] props\n"),
}
DIAGNOSTICS = {"type": "diagnostic_msgs/DiagnosticArray"}


@contextmanager
def observed_robot(tmp_path: Path, **board_options: int) -> Iterator[tuple[Robot, str, Client]]:
    """A robot with ROS 1 and a board, whose service only looks on."""
    with (
        robot(tmp_path) as ros,
        emulator("--on", "3") as board,
        served(tmp_path) as (_, url),
        Client(url) as client,
    ):
        client.put_model("bot", json.dumps(MODEL))
        at = {"host": "127.0.0.1", "port": board.port, "protected": [], **board_options}
        client.put_robot("tedusar", {"model": "bot", "policy": "observe", "board": at})
        yield ros, url, client


def heard(watcher: RosNode, topic: str) -> list[Any]:
    return [line["value"] for line in tuple(watcher.heard) if line["heard"] == topic]


def statuses(watcher: RosNode) -> dict[str, int]:
    """Return the levels that /diagnostics had last, by name."""
    messages = heard(watcher, "/diagnostics")
    return {status["name"]: status["level"] for status in messages[-1]["status"]} if messages else {}


def test_a_robot_is_told_its_diagnosis_and_heard_in_the_formats_of_the_published_system(
    tmp_path: Path,
) -> None:
    with observed_robot(tmp_path) as (ros, url, client):
        laser, watcher = ros.node("laser"), ros.node("watcher")
        laser.do("publish", topic="/scan", type="std_msgs/String", rate=10)
        watcher.do("subscribe", topic="/observations", **OBSERVATIONS)
        watcher.do("subscribe", topic="/diagnosis", **DIAGNOSIS)
        watcher.do("subscribe", topic="/diagnostics", **DIAGNOSTICS)
        watcher.do("subscribe", topic="/board_measurments", **BOARD)
        sections: dict[str, Any] = {
            "ros1": {"master": ros.master.uri, "observations_s": 3},
            "topics": {"scan": {"from": "ros1", "first_s": 60, "tolerance_hz": 8}},
            "observers": {
                "laser": {"kind": "node", "from": "ros1", "preset": "ros1"},
            },
        }

        def obs() -> dict[str, str]:
            return {
                one["literal"]: one["source"]
                for one in client.observations("tedusar")["observations"]
                if one["fresh"]
            }

        def told(topic: str, true: Callable[[Any], bool]) -> Callable[[], bool]:
            return lambda: any(true(message) for message in heard(watcher, topic))

        with agent(config(tmp_path, url, {}, **sections)):
            until(told("/observations", lambda m: "ok(scan)" in m["obs"]), "ok(scan) on /observations", 60)
            well = {"robomend: lamp": 0, "robomend: laser": 0, "robomend: mapper": 0}
            until(lambda: statuses(watcher) == well, "all well", 60)
            until(lambda: heard(watcher, "/board_measurments"), "the board's channels", 60)
            (lamp,) = (c for c in heard(watcher, "/board_measurments")[-1]["channel"] if c["id"] == 3)
            assert (lamp["dev_connected"], lamp["status"]) == ("lamp", 1)
            assert lamp["current"] > 0
            assert heard(watcher, "/diagnosis") == []  # silent when all is well

            mine = ros.node("my_observer")
            said = {"obs": ["~Ok(/temp_cpu1) and ok(map)", "why?"]}
            mine.do("publish", topic="/observations", value=said, rate=10, **OBSERVATIONS)
            until(lambda: {"not ok(temp_cpu1)", "ok(map)"} <= obs().keys(), "the sentences of others", 60)
            assert obs()["ok(map)"] == "ROS /observations"
            # No echo of our own; unknown for a moment where the agent was held up.
            until(lambda: obs().get("ok(scan)") == "agent onboard", "the agent's own word on scan", 60)
            mine.do("hush", topic="/observations")
            until(lambda: "ok(map)" not in obs(), "what nobody repeats is unknown", 60)

            laser.kill()
            until(
                told("/diagnosis", lambda m: m["diag"] == [{"good": ["lamp", "mapper"], "bad": ["laser"]}]),
                "the diagnosis",
                60,
            )
            until(lambda: statuses(watcher).get("robomend: laser") == 2, "an error on /diagnostics", 60)
            said_last = heard(watcher, "/diagnostics")[-1]["status"]
            (broken,) = (status for status in said_last if status["level"] == 2)
            assert broken["hardware_id"] == "laser"
            assert "laser" in {pair["key"]: pair["value"] for pair in broken["values"]}["diagnosis 1"]
        log = (tmp_path / "agent.log").read_text()
        assert log.count("not understood: 'why?' is no literal") == 1


SYSTEM_MODEL = {
    "type": "tug_ist_diagnosis_msgs/SystemModelResult",
    "definition": "string ab\nstring nab\nstring neg_prefix\nstring[] rules\nstring[] props\n",
}


def test_the_model_server_gives_the_robots_model_to_clients_and_listeners_of_the_published_system(
    tmp_path: Path,
) -> None:
    with observed_robot(tmp_path) as (ros, url, client):
        engine = ros.node("engine")
        engine.do("subscribe", topic="/diagnosis_model", **SYSTEM_MODEL)
        section = {"master": ros.master.uri, "serve": ["diagnosis_model_server"]}
        with agent(config(tmp_path, url, {}, ros1=section)):
            found = engine.do("act", name="diagnosis_model_server", goal={"goal": 1}, **MODEL_ACTION)
            assert (found["state"], found["answer"]["ab"], found["answer"]["nab"]) == (SUCCEEDED, "AB", "NAB")
            until(
                lambda: heard(engine, "/diagnosis_model") == [found["answer"]], "the model on its topic", 60
            )
            told = found["answer"]
            model = client.model("bot").value["source"]
            # What is told is the model: the engine finds the same in both.
            said = {"observations": ["not ok(map)"]}
            again = client.diagnose({"source": json.dumps(told), **said})
            assert again["diagnoses"] == client.diagnose({"source": model, **said})["diagnoses"]
            assert {frozenset(one["bad"]) for one in again["diagnoses"]} == {
                frozenset({"laser"}), frozenset({"mapper"})
            }  # fmt: skip


def test_a_ros_node_switches_a_device_through_the_service_whose_stop_and_protection_hold(
    tmp_path: Path,
) -> None:
    with observed_robot(tmp_path, rate_hz=20) as (ros, url, client):
        asks = ros.node("operator")

        def lamp() -> bool | None:
            return next(c["on"] for c in client.board("tedusar")["channels"] if c["component"] == "lamp")

        def act(name: str, *parameters: str) -> tuple[int, int]:
            found = asks.do("act", name=name, parameter=list(parameters), **REPAIR)
            return found["state"], found["result"]

        section = {"master": ros.master.uri, "serve": ["power_up", "shutdown"]}
        with agent(config(tmp_path, url, {}, ros1=section)):
            until(lamp, "the lamp that is on", 60)
            assert act("shutdown", "lamp") == (SUCCEEDED, 0)
            until(lambda: lamp() is False, "the lamp off", 60)
            assert act("power_up", "lamp") == (SUCCEEDED, 0)
            until(lamp, "the lamp on", 60)
            assert act("shutdown", "lamp2") == (REJECTED, 2)
            client.stop("an operator says so")
            assert act("shutdown", "lamp") == (REJECTED, 2)
            assert lamp() is True
