"""What nodes of ROS 2 are asked for: real rclpy nodes, services, parameters and lifecycles."""

from __future__ import annotations

import ast
import asyncio
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from tests.ros2 import Ros2Robot
from tests.waiting import until

from robomend_client.actions import FAILED, OK, REFUSED, TIMED_OUT, UNREACHABLE, Action, ActionResult
from robomend_client.agent.executors.ros2_asking import (
    Ended,
    component,
    controllers,
    fill,
    lifecycle,
    mode,
    wanted,
)
from robomend_client.agent.executors.ros_programs import (
    ASKING,
    CallService,
    Lifecycle,
    ParameterChange,
    Ros2Asking,
    SetParameter,
)

TRIGGER, SET_BOOL = "std_srvs/srv/Trigger", "std_srvs/srv/SetBool"


def do(ros: Ros2Robot, executor: Ros2Asking, *parameters: str, timeout_s: float = 60.0) -> ActionResult:
    executor.attach({"ROS_DOMAIN_ID": str(ros.domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"})
    action = Action("r:1", executor.name, parameters, timeout_s)
    return asyncio.run(executor.execute(action, lambda number, message: None))


def test_real_nodes_are_asked_for_services_parameters_and_lifecycles(
    ros2: Ros2Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROBOMEND_RCLPY_PYTHON", str(ros2.python))
    node = ros2.node("server")
    node.do("offer", name="/reset", type=TRIGGER, answer={"success": True, "message": "was reset"})
    node.do("offer", name="/power", type=SET_BOOL, answer={"success": False, "message": "the lid\nis open"})
    ros2.node("deaf").do("offer", name="/mute", type=TRIGGER, never=True)
    node.do("declare", name="fps", value=15, most=60)
    node.do("declare", name="serial", value="x1", read_only=True)
    node.do("lifecycle", name="managed")
    node.do("lifecycle", name="stubborn", refuses=True)

    def call(service: str, kind: str, *more: Any, timeout_s: float = 60.0) -> ActionResult:
        return do(ros2, CallService("act", {"a": service}, kind, *more), "a", timeout_s=timeout_s)

    waiting = ThreadPoolExecutor()  # while others are asked
    mute, nobody = (waiting.submit(call, one, TRIGGER, timeout_s=15) for one in ("/mute", "/nothing"))
    assert call("/reset", TRIGGER) == ActionResult(OK, "/reset: was reset")
    power = CallService("power", {"a": "/power"}, SET_BOOL, {"data": "{on}"}, {"on": ["true", "false"]})
    refused = ActionResult(FAILED, "/power answered success: false: the lid is open")
    assert do(ros2, power, "a", "true") == refused
    until(lambda: len(node.heard) == 2, "what was asked", 60)
    assert node.heard[1]["value"] == {"data": True}
    other = "/power is of type std_srvs/srv/SetBool, not std_srvs/srv/Trigger; it was not asked"
    assert call("/power", TRIGGER) == ActionResult(REFUSED, other)
    assert len(node.heard) == 2  # /power was not asked once more

    at, ways = {"camera": "/server"}, {"values": {"low": "5", "high": "90"}, "steps": {"more": "20"}}
    change = ParameterChange("fps", **ways, back="before", least=1, most=30)
    fps, again = SetParameter("set_fps", at, change), SetParameter("set_fps", at, change)
    fps.before.keep_in(tmp_path)
    assert do(ros2, fps, "camera", "before").message == "fps of /server: it was not changed by this agent"
    assert do(ros2, fps, "camera", "low") == ActionResult(OK, "fps of /server is 5 now; it was 15")
    said = "/server, asked to set fps to 90, answered successful: false: the lens does not do that"
    assert do(ros2, fps, "camera", "high") == ActionResult(FAILED, said)
    assert do(ros2, fps, "camera", "more").message == "fps of /server is 25 now; it was 5"
    again.before.keep_in(tmp_path)  # another agent's life
    assert do(ros2, again, "camera", "before") == ActionResult(OK, "fps of /server is 15 now; it was 25")
    assert do(ros2, again, "camera", "before").code == REFUSED
    for name, why in (("serial", "read-only"), ("fsp", "undeclared parameter")):
        found = do(ros2, SetParameter("rename", at, ParameterChange(name, {"y": "y1"})), "camera", "y")
        assert (found.code, why in found.message) == (FAILED, True)

    up = Lifecycle("bring_up", {"camera_node": "/managed"}, "restart")
    assert do(ros2, up, "camera_node") == ActionResult(OK, "/managed: configure → activate is done")
    everything = "/managed: deactivate → cleanup → configure → activate is done"
    assert do(ros2, up, "camera_node").message == everything
    assert do(ros2, Lifecycle("restart", {"x": "/stubborn"}), "x") == ActionResult(
        FAILED, "/stubborn refuses to configure, or failed to: it is unconfigured"
    )
    assert nobody.result() == ActionResult(UNREACHABLE, "nobody offers the service /nothing")
    assert mute.result().code == TIMED_OUT
    assert "/mute does not answer within 12 s; whether it acted is unknown" in mute.result().message


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


@pytest.mark.parametrize(
    ("given", "why"), [({"dta": "true"}, "dta"), ({"data": "maybe"}, "'maybe' is neither true nor false")]
)
def test_a_request_that_cannot_be_made_says_why(given: dict[str, str], why: str) -> None:
    with pytest.raises((AttributeError, ValueError), match=why):
        fill(SimpleNamespace(data=False), given)


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


def test_one_change_of_a_lifecycle_is_made_unless_it_is_so_already() -> None:
    state = SimpleNamespace(current_state=SimpleNamespace(id=3, label="active"))
    ask = Asked(get_state=lambda _: state, change_state={"success": True})
    said = {"name": "/n", "transition": "activate"}
    assert lifecycle(ask, said) == "/n is active already"
    assert lifecycle(ask, {**said, "transition": "deactivate"}) == "/n: deactivate is done"
    assert ask.asked[-1] == ("change_state", {"transition.id": 4})
    state.current_state.id = 2
    assert lifecycle(ask, {**said, "transition": "restart"}) == "/n: cleanup → configure → activate is done"
    state.current_state.id = 4
    with pytest.raises(Ended, match="/n is finalized: it cannot be brought up again"):
        lifecycle(ask, {**said, "transition": "restart"})


@pytest.mark.parametrize(("now", "by", "to"), [(10, 5, 15), (1.0, -0.5, 0.5), (28, 5, 30), (3, -5, 1)])
def test_a_step_ends_at_its_bounds(now: float, by: float, to: float) -> None:
    said = {"name": "/n", "parameter": "p", "by": by, "least": 0.5 if now == 1.0 else 1, "most": 30}
    assert wanted(said, now) == to
    assert type(wanted(said, now)) is type(now)


def test_at_a_bound_no_step_is_asked_for() -> None:
    said = {"name": "/n", "parameter": "p", "by": 5, "least": 1, "most": 30}
    with pytest.raises(Ended, match="p of /n is 30 already, its bound"):
        wanted(said, 30)


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
