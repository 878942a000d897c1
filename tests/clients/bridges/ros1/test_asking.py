"""What nodes of ROS 1 are asked for: real rospy services, the real parameter server."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from tests.ros1 import Robot
from tests.waiting import until

from robomend_client.actions import FAILED, OK, REFUSED, TIMED_OUT, UNREACHABLE, Action, ActionResult
from robomend_client.agent.executors.ros_programs import ParameterChange
from robomend_client.bridges.problems import Problems
from robomend_client.bridges.ros1.asking import (
    DEFINITIONS,
    MESSAGES,
    CallRos1Service,
    Ros1Asking,
    ServiceType,
    SetRos1Parameter,
)
from robomend_client.bridges.ros1.node import RosNode

MD5 = {
    "std_srvs/Empty": "d41d8cd98f00b204e9800998ecf8427e",
    "std_srvs/Trigger": "937c9679a518e3a18d831e57125ea522",
    "std_srvs/SetBool": "09fb03525b03e7ea1fd3992bafd87e16",
    "dynamic_reconfigure/Reconfigure": "bb125d226a21982a4a98760418dc2672",
    "controller_manager_msgs/SwitchController": "b29a7abc673b2c54c14b54e50f8d06a5",
}
"""As genmsg computes them."""

SWITCH = """string[] start_controllers
string[] stop_controllers
int32 strictness
int32 BEST_EFFORT=1
int32 STRICT=2
bool start_asap   # at once
float64 timeout
---
bool ok
"""


def definition(kind: str) -> str:
    return DEFINITIONS.get(kind, SWITCH)


@pytest.mark.parametrize("kind", MD5)
def test_md5_sums_are_those_of_ros(kind: str) -> None:
    assert ServiceType(kind, definition(kind)).md5 == MD5[kind]


def offered(kind: str, **more: Any) -> dict[str, Any]:
    """Return what a node offers."""
    request, _, response = definition(kind).partition("---\n")
    texts = []
    for text in (request, response):
        inside = "".join(
            f"{'=' * 80}\nMSG: {name}\n{message}" for name, message in MESSAGES.items() if "Config" in text
        )
        texts.append(text + inside)
    return {"type": kind, "md5": MD5[kind], "request": texts[0], "response": texts[1], **more}


def do(ros: Robot, executor: Ros1Asking, *parameters: str, timeout_s: float = 60.0) -> ActionResult:
    executor.attach(RosNode("/robomend_test", ros.master.uri, "127.0.0.1", Problems("ROS 1")))
    action = Action("r:1", executor.name, parameters, timeout_s)
    return asyncio.run(executor.execute(action, lambda number, message: None))


def test_services_are_asked_and_their_answers_understood_and_who_is_not_meant_is_not_asked(
    ros1: Robot,
) -> None:
    node = ros1.node("server")
    switch = "controller_manager_msgs/SwitchController"
    answers: dict[str, tuple[str, dict[str, Any]]] = {
        "/clear": ("std_srvs/Empty", {}),
        "/reset": ("std_srvs/Trigger", {"answer": {"success": True, "message": "was reset"}}),
        "/power": ("std_srvs/SetBool", {"answer": {"success": False, "message": "the lid is open"}}),
        "/breaks": ("std_srvs/Trigger", {"fails": "no arm here"}),
        "/arm/switch": (switch, {"answer": {"ok": True}}),
        "/leg/switch": (switch, {"answer": {"ok": False}}),
        "/mute": ("std_srvs/Trigger", {"never": True}),
    }
    for name, (kind, more) in answers.items():
        node.do("offer", name=name, **offered(kind, **more))

    def call(service: str, kind: str, *more: Any, timeout_s: float = 60.0, **options: Any) -> ActionResult:
        return do(
            ros1, CallRos1Service("act", {"a": service}, kind, *more, **options), "a", timeout_s=timeout_s
        )

    assert call("/clear", "std_srvs/Empty") == ActionResult(OK, "/clear: done")
    assert call("/reset", "std_srvs/Trigger") == ActionResult(OK, "/reset: was reset")
    power = CallRos1Service(
        "power", {"a": "/power"}, "std_srvs/SetBool", {"data": "{on}"}, {"on": ["true", "false"]}
    )
    refused = ActionResult(FAILED, "/power answered success: false: the lid is open")
    assert do(ros1, power, "a", "true") == refused
    broken = call("/breaks", "std_srvs/Trigger")
    assert (broken.code, "no arm here" in broken.message) == (FAILED, True)
    request = {"start_controllers": '["{to}"]', "stop_controllers": "[]", "strictness": "2"}
    own = CallRos1Service(
        "switch", {"arm": "/arm/switch", "leg": "/leg/switch"}, switch, request, {"to": ["slow"]}, SWITCH
    )
    assert do(ros1, own, "arm", "slow").code == OK
    until(lambda: len(node.heard) == 5, "its line, which comes beside its answer")
    assert node.heard[-1]["value"]["start_controllers"] == ["slow"]
    assert node.heard[-1]["value"]["strictness"] == 2
    assert "answered ok: false" in do(ros1, own, "leg", "slow").message
    assert [line["value"] for line in node.heard][2] == {"data": True}
    asked = 6
    until(lambda: len(node.heard) == asked, "its line")
    missing = call("/nothing", "std_srvs/Trigger")
    assert missing == ActionResult(UNREACHABLE, "nobody offers the service /nothing")
    other = "/power is of type std_srvs/SetBool, not std_srvs/Trigger; it was not asked"
    assert call("/power", "std_srvs/Trigger") == ActionResult(REFUSED, other)
    for more, why in (
        ({"definition": "bool dat\n---\nbool success\n"}, "another version of std_srvs/SetBool; it was not"),
        ({"request": {"dta": "true"}}, "has no field dta; there are data"),
    ):
        assert why in call("/power", "std_srvs/SetBool", **more).message
    assert "there is no definition of my_srvs/Reset here" in call("/power", "my_srvs/Reset").message
    assert len(node.heard) == asked
    mute = call("/mute", "std_srvs/Trigger", timeout_s=5)
    assert mute == ActionResult(TIMED_OUT, "/mute does not answer within 4 s; whether it acted is unknown")


def test_parameters_are_set_on_the_server_or_by_dynamic_reconfigure_and_set_back(
    ros1: Robot, tmp_path: Path
) -> None:
    node = ros1.node("camera")
    node.do("parameter", name="/camera/fps", value=15)
    node.do("parameter", name="/lidar/rate", value=10.0)
    reconfigure = offered("dynamic_reconfigure/Reconfigure", echo=True)
    node.do("offer", name="/lidar/set_parameters", **reconfigure)
    ways: dict[str, Any] = {"values": {"low": "5"}, "back": "before", "steps": {"more": "20"}}
    fps = SetRos1Parameter("set_fps", {"camera": "/camera"}, ParameterChange("fps", **ways, least=1, most=30))
    fps.before.keep_in(tmp_path)
    assert do(ros1, fps, "camera", "before").code == REFUSED
    low = do(ros1, fps, "camera", "low")
    assert low.code == OK
    assert low.message.startswith(
        "fps of /camera is 5 now on the parameter server; a node that reads it only"
    )
    assert node.do("parameter", name="/camera/fps") == 5
    assert do(ros1, fps, "camera", "low").message == "fps of /camera is 5 already"
    assert do(ros1, fps, "camera", "more").code == OK
    assert do(ros1, fps, "camera", "before").code == OK
    assert node.do("parameter", name="/camera/fps") == 15
    missing = do(
        ros1, SetRos1Parameter("x", {"c": "/camera"}, ParameterChange("fsp", {"low": "5"})), "c", "low"
    )
    assert missing == ActionResult(
        REFUSED, "fsp of /camera cannot be set: the parameter server has none of this name"
    )
    rate = SetRos1Parameter("set_rate", {"lidar": "/lidar"}, ParameterChange("rate", {"slow": "2.5"}))
    assert do(ros1, rate, "lidar", "slow") == ActionResult(OK, "rate of /lidar is 2.5 now; it was 10.0")
    until(lambda: node.heard, "its line, which comes beside its answer")
    (asked,) = node.heard
    assert asked["value"]["config"]["doubles"] == [{"name": "rate", "value": 2.5}]


def test_without_a_section_ros1_nobody_is_asked() -> None:
    executor = CallRos1Service("reset", {"a": "/reset"}, "std_srvs/Trigger")
    action = Action("r:1", "reset", ("a",), 5.0)
    result = asyncio.run(executor.execute(action, lambda number, message: None))
    assert result == ActionResult(UNREACHABLE, "reset(a): the agent's file has no section ros1")
