"""Listening to a robot of which nothing is known; test_attach.py has one of each kind."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.ros1 import robot as ros1_robot
from tests.ros2 import robot as ros2_robot
from tests.waiting import eventually

from robomend_client.bridges.hearing import Hearing, Ros1Hearing, Ros2Hearing
from robomend_client.ros_graph import Heard, HeardDevice

DIAGNOSTICS = "diagnostic_msgs/DiagnosticArray"
STATUS = {"status": [{"name": "mapper: cpu", "level": 0, "message": "fine", "hardware_id": "xavier-7"}]}
CONTROLLED = """<robot name="r"><ros2_control name="base" type="system"><hardware>
<plugin>diffdrive/Serial</plugin></hardware></ros2_control></robot>"""


def listened(hearing: Hearing, enough: Callable[[Heard], bool]) -> Heard:
    """Listen until enough was heard."""

    async def listen() -> Heard:
        task = asyncio.create_task(hearing.run())
        try:
            await eventually(lambda: task.done() or enough(hearing.heard()), "all of it was heard")
            if task.done():
                task.result()
            return hearing.heard()
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    return asyncio.run(listen())


def enough(heard: Heard) -> bool:
    counts = {name: topic.count for name, topic in heard.topics.items()}
    listens = heard.graph.subscribers.get("/scan", frozenset())
    named = "/unknown_node" not in heard.graph.nodes and "/mapper" in listens
    flowed = (
        named and counts.get("/scan", 0) > 20 and counts.get("/pose", 0) > 20 and counts.get("/map", 0) > 0
    )
    device = heard.devices.get("xavier-7")
    flowed = flowed and device is not None and bool(device.node) and len(heard.devices) > 1
    return flowed and bool(heard.statuses) and bool(heard.actions) and "/cmd_vel" in counts


def test_a_robot_with_ros_2_is_heard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with ros2_robot(tmp_path) as ros:
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        kind = "std_msgs/String"
        ros.node("laser").do("publish", topic="/scan", type=kind, rate=10, reliable=False)
        mapper = ros.node("mapper_30719_1739203333671")  # as an anonymous one
        mapper.do("subscribe", topic="/scan", type=kind)
        mapper.do("publish", topic="/map", type=kind, latched=True)
        mapper.do("publish", topic="/pose", type=kind, rate=20)
        mapper.do("publish", topic="/cmd_vel", type=kind, rate=0.001)
        mapper.do("publish", topic="/diagnostics", type=DIAGNOSTICS, rate=5, value=STATUS)
        mapper.do("serve", name="/fib")
        mapper.do("lifecycle", name="camera")
        about = {"topic": "/robot_description", "type": kind, "value": {"data": CONTROLLED}}
        mapper.do("publish", **about, latched=True)
        heard = listened(Ros2Hearing(ros.domain), enough)
    assert {"/laser", "/mapper"} <= heard.graph.nodes
    assert heard.graph.publishers["/pose"] == {"/mapper"}
    assert heard.graph.subscribers["/scan"] >= {"/mapper"}
    assert heard.topics["/scan"].usual_s == pytest.approx(0.1, rel=0.5)
    assert heard.topics["/cmd_vel"].count == 0
    assert [name for name, one in heard.topics.items() if one.latched and name in ("/scan", "/map")] == [
        "/map"
    ]
    assert heard.statuses["mapper: cpu"].levels == {0}
    assert heard.statuses["mapper: cpu"].publishers == {"/mapper"}
    assert heard.actions == {"/fib": "/mapper"}
    assert heard.devices["xavier-7"] == HeardDevice("hardware_id of the status 'mapper: cpu'", "/mapper")
    assert not heard.gone
    assert heard.seconds > 0
    assert heard.devices["base"].source == "ros2_control of robot_description, diffdrive/Serial"
    assert heard.lifecycle == {"/camera": ""}
    assert heard.origin == {"ros2": {"domain": ros.domain}}
    assert any("no message goes there" in remark for remark in heard.remarks)


def test_a_node_that_ends_is_told_and_one_that_comes_later_is_heard(tmp_path: Path) -> None:
    with ros1_robot(tmp_path) as ros:
        kind = "std_msgs/String"
        ros.node("laser").do("publish", topic="/scan", type=kind, rate=20)
        ros.node("setup").do("publish", topic="/done", type=kind, rate=20)
        hearing = Ros1Hearing(ros.master.uri)
        phase: list[str] = []

        def seen(heard: Heard) -> bool:
            if not phase and heard.topics.get("/done") and heard.topics["/done"].count > 3:
                phase.append("ended")
                ros.nodes["setup"].kill()
                ros.node("late").do("publish", topic="/later", type=kind, rate=20)
            return "/setup" in heard.gone and "/later" in heard.topics and heard.topics["/later"].count > 3

        heard = listened(hearing, seen)
    assert "/late" in heard.graph.nodes
    assert heard.gone == {"/setup"}
