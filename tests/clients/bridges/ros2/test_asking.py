"""What nodes of ROS 2 are asked for: real rclpy nodes, services, parameters and lifecycles."""

from __future__ import annotations

import ast
import asyncio
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from tests.ros2 import Ros2Robot, robot
from tests.waiting import until

from robomend_client.actions import FAILED, OK, REFUSED, TIMED_OUT, UNREACHABLE, Action, ActionResult
from robomend_client.agent.executors import ros2_asking
from robomend_client.agent.executors.ros2_asking import Ended, component, controllers, mode, wanted
from robomend_client.agent.executors.ros_programs import (
    ASKING,
    CallService,
    Lifecycle,
    ParameterChange,
    Ros2Asking,
    SetParameter,
)

TRIGGER, SET_BOOL = "std_srvs/srv/Trigger", "std_srvs/srv/SetBool"


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ros2Robot]:
    with robot(tmp_path_factory.mktemp("robot")) as found:
        yield found


@pytest.fixture
def python(ros: Ros2Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROBOMEND_RCLPY_PYTHON", str(ros.python))


def do(ros: Ros2Robot, executor: Ros2Asking, *parameters: str, timeout_s: float = 60.0) -> ActionResult:
    executor.attach({"ROS_DOMAIN_ID": str(ros.domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"})
    action = Action("r:1", executor.name, parameters, timeout_s)
    return asyncio.run(executor.execute(action, lambda number, message: None))


@pytest.mark.usefixtures("python")
def test_services_are_called_and_their_answers_understood(ros: Ros2Robot) -> None:
    node = ros.node("server")
    node.do("offer", name="/clear", type="std_srvs/srv/Empty")
    node.do("offer", name="/reset", type=TRIGGER, answer={"success": True, "message": "was reset"})
    node.do("offer", name="/power", type=SET_BOOL, answer={"success": False, "message": "the lid\nis open"})
    asked = {"/clear": CallService("clear", {"a": "/clear"}, "std_srvs/srv/Empty")}
    assert do(ros, asked["/clear"], "a") == ActionResult(OK, "/clear: done")
    assert do(ros, CallService("reset", {"a": "/reset"}, TRIGGER), "a") == ActionResult(
        OK, "/reset: was reset"
    )
    power = CallService("power", {"a": "/power"}, SET_BOOL, {"data": "{on}"}, {"on": ["true", "false"]})
    refused = do(ros, power, "a", "true")
    assert refused == ActionResult(FAILED, "/power answered success: false: the lid is open")
    assert do(ros, power, "a", "false").code == FAILED
    until(lambda: len(node.heard) == 4, "what was asked", 60)
    assert [line["value"] for line in node.heard][2:] == [{"data": True}, {"data": False}]


@pytest.mark.usefixtures("python")
def test_who_never_answers_is_not_there_or_of_another_type_is_told_apart(ros: Ros2Robot) -> None:
    node = ros.node("odd")
    node.do("offer", name="/mute", type=TRIGGER, never=True)
    node.do("offer", name="/other", type=SET_BOOL)
    mute = do(ros, CallService("reset", {"a": "/mute"}, TRIGGER), "a", timeout_s=15)
    assert mute.code == TIMED_OUT
    assert "/mute does not answer within 12 s; whether it acted is unknown" in mute.message
    nobody = do(ros, CallService("reset", {"a": "/nothing"}, TRIGGER), "a")
    assert nobody == ActionResult(UNREACHABLE, "nobody offers the service /nothing")
    other = do(ros, CallService("reset", {"a": "/other"}, TRIGGER), "a")
    assert other == ActionResult(
        REFUSED, "/other is of type std_srvs/srv/SetBool, not std_srvs/srv/Trigger; it was not asked"
    )
    field = do(ros, CallService("reset", {"a": "/other"}, SET_BOOL, {"dta": "true"}), "a")
    assert field.code == REFUSED
    assert "dta" in field.message
    value = do(ros, CallService("reset", {"a": "/other"}, SET_BOOL, {"data": "maybe"}), "a")
    assert "'maybe' is neither true nor false" in value.message
    assert [line["heard"] for line in node.heard] == ["/mute"]  # /other was never asked


@pytest.mark.usefixtures("python")
def test_parameters_are_set_stepped_and_set_back_in_the_nodes_own_words(
    ros: Ros2Robot, tmp_path: Path
) -> None:
    node = ros.node("camera")
    node.do("declare", name="fps", value=15, most=60)
    node.do("declare", name="gain", value=1.5)
    node.do("declare", name="serial", value="x1", read_only=True)
    at = {"camera": "/camera"}
    ways: dict[str, Any] = {"values": {"low": "5", "high": "90"}, "back": "before", "steps": {"more": "20"}}
    fps = SetParameter("set_fps", at, ParameterChange("fps", **ways, least=1, most=30))
    fps.before.keep_in(tmp_path)
    assert do(ros, fps, "camera", "before").message == "fps of /camera: it was not changed by this agent"
    assert do(ros, fps, "camera", "low") == ActionResult(OK, "fps of /camera is 5 now; it was 15")
    assert do(ros, fps, "camera", "low") == ActionResult(OK, "fps of /camera is 5 already")
    assert do(ros, fps, "camera", "high") == ActionResult(
        FAILED, "/camera, asked to set fps to 90, answered successful: false: the lens does not do that"
    )
    assert do(ros, fps, "camera", "more").message == "fps of /camera is 25 now; it was 5"
    assert do(ros, fps, "camera", "more").message == "fps of /camera is 30 now; it was 25"
    assert do(ros, fps, "camera", "more") == ActionResult(REFUSED, "fps of /camera is 30 already, its bound")
    again = SetParameter("set_fps", at, ParameterChange("fps", **ways, least=1, most=30))
    again.before.keep_in(tmp_path)  # another agent's life
    assert do(ros, again, "camera", "before") == ActionResult(OK, "fps of /camera is 15 now; it was 30")
    assert do(ros, again, "camera", "before").code == REFUSED
    gain = SetParameter("set_gain", at, ParameterChange("gain", {"two": "2"}))
    assert do(ros, gain, "camera", "two") == ActionResult(OK, "gain of /camera is 2.0 now; it was 1.5")
    serial = do(ros, SetParameter("rename", at, ParameterChange("serial", {"y": "y1"})), "camera", "y")
    assert serial.code == FAILED
    assert "read-only" in serial.message
    missing = do(ros, SetParameter("set_fsp", at, ParameterChange("fsp", {"low": "5"})), "camera", "low")
    assert missing.code == FAILED
    assert "fsp" in missing.message
    assert "undeclared parameter" in missing.message


@pytest.mark.usefixtures("python")
def test_a_lifecycle_is_brought_up_again_from_wherever_it_is(ros: Ros2Robot) -> None:
    node = ros.node("host")
    node.do("lifecycle", name="managed")
    node.do("lifecycle", name="stubborn", refuses=True)
    at = {"camera_node": "/managed"}
    up = Lifecycle("bring_up", at, "restart")
    assert do(ros, up, "camera_node") == ActionResult(OK, "/managed: configure → activate is done")
    assert do(ros, Lifecycle("activate", at), "camera_node").message == "/managed is active already"
    again = do(ros, up, "camera_node")
    assert again.message == "/managed: deactivate → cleanup → configure → activate is done"
    assert do(ros, Lifecycle("deactivate", at), "camera_node").code == OK
    assert do(ros, up, "camera_node").message == "/managed: cleanup → configure → activate is done"
    assert do(ros, Lifecycle("restart", {"x": "/stubborn"}), "x") == ActionResult(
        FAILED, "/stubborn refuses to configure, or failed to: it is unconfigured"
    )


# --- stand-ins for packages of which there is no wheel ----------------------------------------------------


class Asked:
    """Answers as the services of a package do, and notes what was asked."""

    def __init__(self, **answers: Any) -> None:
        self.answers = answers
        self.asked: list[tuple[str, dict[str, Any]]] = []

    def __call__(self, name: str, types: Any, request: Any) -> Any:
        short = name.rpartition("/")[2]
        self.asked.append((short, dict(request)))
        answer = self.answers[short]
        return answer(request) if callable(answer) else SimpleNamespace(**answer)


def test_controllers_are_switched_once_and_unknown_ones_named() -> None:
    there = [SimpleNamespace(name="arm", state="active"), SimpleNamespace(name="wheels", state="inactive")]
    ask = Asked(list_controllers={"controller": there}, switch_controller={"ok": True})
    said = {"name": "/manager", "activate": ["wheels"], "deactivate": ["arm"]}
    assert controllers(ask, said) == "/manager: active wheels; inactive arm"
    assert ask.asked[1] == (
        "switch_controller",
        {"activate_controllers": ["wheels"], "deactivate_controllers": ["arm"], "strictness": 2},
    )
    so_already = Asked(list_controllers={"controller": there})
    assert "so already" in controllers(so_already, {"name": "/manager", "activate": ["arm"]})
    with pytest.raises(Ended, match="/manager has no controller leg; there are arm, wheels"):
        controllers(ask, {"name": "/manager", "activate": ["leg"]})
    refuses = Asked(list_controllers={"controller": there}, switch_controller={"ok": False})
    with pytest.raises(Ended, match="/manager answered ok: false"):
        controllers(refuses, said)


def test_modes_are_asked_for_and_components_loaded_anew() -> None:
    ask = Asked(get_mode={"current_mode": "NORMAL"}, change_mode={"success": True})
    assert mode(ask, {"name": "/base", "mode": "NORMAL"}) == "/base is in mode NORMAL already"
    assert "changes to SLOW" in mode(ask, {"name": "/base", "mode": "SLOW"})
    assert ask.asked[-1] == ("change_mode", {"mode_name": "SLOW"})
    answers: dict[str, Any] = {
        "list_nodes": {"full_node_names": ["/a/cam"], "unique_ids": [7]},
        "unload_node": {"success": True, "error_message": ""},
        "load_node": {"success": False, "error_message": "no such plugin"},
    }
    parts = Asked(**answers)
    said = {"name": "/box", "verb": "restart", "node": "/a/cam", "package": "p", "plugin": "p::Cam"}
    with pytest.raises(Ended, match="success: false: no such plugin"):
        component(parts, said)
    assert parts.asked[1:] == [
        ("unload_node", {"unique_id": 7}),
        (
            "load_node",
            {"package_name": "p", "plugin_name": "p::Cam", "node_name": "cam", "node_namespace": "/a"},
        ),
    ]
    assert component(parts, {**said, "verb": "load"}) == "/a/cam is loaded already"


@pytest.mark.parametrize(("now", "by", "to"), [(10, 5, 15), (1.0, -0.5, 0.5), (28, 5, 30), (3, -5, 1)])
def test_a_step_ends_at_its_bounds(now: float, by: float, to: float) -> None:
    said = {"name": "/n", "parameter": "p", "by": by, "least": 0.5 if now == 1.0 else 1, "most": 30}
    assert wanted(said, now) == to
    assert type(wanted(said, now)) is type(now)


def test_a_python_without_rclpy_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    executor = CallService("reset", {"a": "/reset"}, TRIGGER, python=sys.executable)
    result = asyncio.run(executor.execute(Action("r:1", "reset", ("a",), 30.0), lambda n, m: None))
    assert result.code == REFUSED
    assert "has no rclpy" in result.message
    assert "setup.bash" in result.message
    missing = CallService("reset", {"a": "/reset"}, TRIGGER, python="/nowhere/python")
    assert asyncio.run(missing.execute(Action("r:1", "reset", ("a",), 30.0), lambda n, m: None)).code == (
        UNREACHABLE
    )


def test_it_is_written_for_python_3_8_and_imports_nothing_of_ours() -> None:
    ast.parse(ASKING.read_text(), str(ASKING), feature_version=(3, 8))
    assert "import robomend" not in ASKING.read_text()
    assert "from robomend" not in ASKING.read_text()
    assert set(ros2_asking.ASKED) == {
        "service", "parameter", "lifecycle", "controllers", "mode", "component"
    }  # fmt: skip
