"""Asks nodes of ROS 2 for one thing, and says what came of it: a program, run by path, with the robot's ROS.

    /usr/bin/python3 ros2_asking.py '{"ask": "service", "name": "/clear", "type": "std_srvs/srv/Trigger"}'

Its last line is JSON: `said`, a sentence, and of a parameter `before`, what it was. Exit code: 0 it was done;
1 the node refused it or failed, in its own words; 2 nothing was asked for, as the type or a name is wrong;
3 nobody answered, so that nobody knows; 4 nobody is there.

It is written for Python 3.8, and imports nothing of robomend: agent/executors/ros_programs.py starts it.
"""

from __future__ import annotations

import importlib
import json
import sys
import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # Python 3.8 makes no alias of it
    from collections.abc import Callable, Mapping, Sequence

    Ask = Callable[[str, Sequence[str], Mapping[str, Any]], Any]
    """Asks a service, by its name, the types that it may have, and the request's fields; gives the answer."""

DONE, FAILED, NOT_ASKED, NO_ANSWER, NOBODY = 0, 1, 2, 3, 4

FOUND_S = 10.0
"""Who is there has been found by then."""

LOOK_S = 0.1

FLAGS = ("success", "ok", "successful")
WORDS = ("message", "status_message", "reason", "error_message", "error_string")
"""Fields of answers by which nodes say whether it was done, and why not."""

LONGEST = 400
"""Characters of a node's own words."""


class Ended(Exception):
    """It ends here, with this exit code and sentence."""

    def __init__(self, code: int, said: str) -> None:
        super().__init__(said)
        self.code = code


# --- answers and requests ---------------------------------------------------------------------------------


def understood(name: str, answer: Any) -> str:
    """Return what an answer says, as a sentence; Ended where it says that it was not done."""
    words = next(
        (str(w) for w in (getattr(answer, one, "") for one in WORDS) if isinstance(w, str) and w), ""
    )
    shown = " ".join(words.split())[:LONGEST]
    for flag in FLAGS:
        value = getattr(answer, flag, None)
        if value is False:
            raise Ended(FAILED, "{} answered {}: false{}".format(name, flag, ": " + shown if shown else ""))
    return "{}: {}".format(name, shown or "done")


def converted(text: Any, now: Any) -> Any:
    """Return a value of a file as the type of what is there now: a text may stand for any of them.

    Raises:
        ValueError: it cannot be one.
    """
    if isinstance(now, bool):
        if text in (True, "true", "True", "yes", "on"):
            return True
        if text in (False, "false", "False", "no", "off"):
            return False
        raise ValueError(f"{text!r} is neither true nor false")
    if isinstance(now, str):
        return text if isinstance(text, str) else json.dumps(text)
    if isinstance(now, float):
        return float(text)
    if isinstance(now, int):
        return int(text)
    value = json.loads(text) if isinstance(text, str) and text.strip()[:1] in "[{" else text
    if isinstance(value, str):  # a list of one, or of several words: [a, b] is no JSON
        value = [part.strip() for part in value.strip("[]").split(",") if part.strip()]
    return value


def fill(request: Any, given: Mapping[str, Any]) -> Any:
    """Set the fields of a request, dotted ones of the messages in it.

    Raises:
        AttributeError, TypeError, ValueError, AssertionError: it has no such field, or of another type.
    """
    for path, value in given.items():
        *way, name = path.split(".")
        part = request
        for step in way:
            part = getattr(part, step)
        now = getattr(part, name)
        if hasattr(now, "tolist") or isinstance(now, (list, tuple)) or type(now).__name__ == "array":
            value = converted(value, None)
            if hasattr(now, "typecode"):
                value = [float(one) if now.typecode in "fd" else int(one) for one in value]
        else:
            value = converted(value, now)
        setattr(part, name, value)
    return request


# --- what can be asked for --------------------------------------------------------------------------------


def service(ask: Ask, said: Mapping[str, Any]) -> str:
    answer = ask(said["name"], [said["type"]], said.get("request") or {})
    return understood(said["name"], answer)


FIELDS = (
    "", "bool_value", "integer_value", "double_value", "string_value", "byte_array_value", "bool_array_value",
    "integer_array_value", "double_array_value", "string_array_value",
)  # fmt: skip


def read(value: Any) -> Any:
    """Return what a ParameterValue holds; None: nothing."""
    if not 0 < value.type < len(FIELDS):
        return None
    found = getattr(value, FIELDS[value.type])
    return list(found) if value.type > 4 else found


def wanted(said: Mapping[str, Any], now: Any) -> Any:
    """Return what a parameter is to be: a value, or a step from what it is now, within bounds.

    Raises:
        Ended: the step leads nowhere.
        ValueError: it cannot be of that type.
    """
    if "by" not in said:
        given = said["value"]
        if now is None:  # not set: as it is written
            return json.loads(given) if isinstance(given, str) and _is_json(given) else given
        if isinstance(now, list):
            parts = converted(given, None)
            return [converted(part, now[0]) for part in parts] if now else parts
        return converted(given, now)
    if isinstance(now, bool) or not isinstance(now, (int, float)):
        raise ValueError(f"it is {now!r}, which is no number to step from")
    to = now + said["by"]
    if said.get("least") is not None:
        to = max(said["least"], to)
    if said.get("most") is not None:
        to = min(said["most"], to)
    to = round(to) if isinstance(now, int) else float(to)
    if to == now or (to - now) * said["by"] < 0:
        raise Ended(
            NOT_ASKED, "{} of {} is {} already, its bound".format(said["parameter"], said["name"], now)
        )
    return to


def _is_json(text: str) -> bool:
    try:
        json.loads(text)
    except ValueError:
        return False
    return True


def parameter(ask: Ask, said: dict[str, Any]) -> str:
    """Set a parameter; `before` in `said` is then what it was."""
    from rcl_interfaces.msg import Parameter, ParameterValue

    node, name = said["name"], said["parameter"]
    found = ask(node + "/get_parameters", ["rcl_interfaces/srv/GetParameters"], {"names": [name]})
    now = read(found.values[0]) if found.values else None
    try:
        value = wanted(said, now)
    except (TypeError, ValueError) as error:
        raise Ended(NOT_ASKED, f"{name} of {node} cannot be set: {error}") from error
    if value == now and type(value) is type(now):
        return f"{name} of {node} is {json.dumps(value)} already"
    kinds = {bool: 1, int: 2, float: 3, str: 4}
    if isinstance(value, list):
        number = 5 + kinds.get(type(value[0]), 4) if value else found.values[0].type
    else:
        number = kinds.get(type(value), 0)
    if number == 0:
        raise Ended(NOT_ASKED, f"{name} of {node} cannot be set to {value!r}")
    new = ParameterValue(type=number, **{FIELDS[number]: value})
    request = {"parameters": [Parameter(name=name, value=new)]}
    answer = ask(node + "/set_parameters", ["rcl_interfaces/srv/SetParameters"], request)
    if not answer.results:
        raise Ended(FAILED, f"{node} answered nothing about {name}")
    understood(f"{node}, asked to set {name} to {json.dumps(value)},", answer.results[0])
    said["before"] = now
    was = "" if now is None else f"; it was {json.dumps(now)}"
    return f"{name} of {node} is {json.dumps(value)} now{was}"


STATES = {1: "unconfigured", 2: "inactive", 3: "active", 4: "finalized"}
CHANGES = {
    "configure": (1, "inactive"),
    "activate": (3, "active"),
    "deactivate": (4, "inactive"),
    "cleanup": (2, "unconfigured"),
}
"""Transition -> its number, and the state that it leads to."""

UP_AGAIN = {
    "active": ("deactivate", "cleanup", "configure", "activate"),
    "inactive": ("cleanup", "configure", "activate"),
    "unconfigured": ("configure", "activate"),
}


def lifecycle(ask: Ask, said: Mapping[str, Any]) -> str:
    """Make one change of a lifecycle, or all that bring the node up again from wherever it is."""
    node, transition = said["name"], said["transition"]

    def state() -> str:
        found = ask(node + "/get_state", ["lifecycle_msgs/srv/GetState"], {}).current_state
        return STATES.get(found.id, str(found.label) or str(found.id))

    begin = state()
    if transition == "restart":
        changes = UP_AGAIN.get(begin)
        if changes is None:
            raise Ended(FAILED, f"{node} is {begin}: it cannot be brought up again from there")
    elif begin == CHANGES[transition][1]:
        return f"{node} is {begin} already"
    else:
        changes = (transition,)
    for change in changes:
        request = {"transition.id": CHANGES[change][0]}
        answer = ask(node + "/change_state", ["lifecycle_msgs/srv/ChangeState"], request)
        if not answer.success:
            raise Ended(FAILED, f"{node} refuses to {change}, or failed to: it is {state()}")
    return "{}: {} is done".format(node, " → ".join(changes))


MANAGER = "controller_manager_msgs/srv/"


def controllers(ask: Ask, said: Mapping[str, Any]) -> str:
    """Switch controllers; those that are as wanted already are left alone."""
    manager = said["name"]
    found = ask(manager + "/list_controllers", [MANAGER + "ListControllers"], {}).controller
    states = {one.name: one.state for one in found}
    on, off = list(said.get("activate") or ()), list(said.get("deactivate") or ())
    for name in (*on, *off):
        if name not in states:
            there = ", ".join(sorted(states)) or "none"
            raise Ended(NOT_ASKED, f"{manager} has no controller {name}; there are {there}")
    on = [name for name in on if states[name] != "active"]
    off = [name for name in off if states[name] == "active"]
    if not on and not off:
        return f"{manager}: all of them are so already"
    request = {"activate_controllers": on, "deactivate_controllers": off, "strictness": 2}
    before_humble = {"start_controllers": on, "stop_controllers": off, "strictness": 2}
    try:
        answer = ask(manager + "/switch_controller", [MANAGER + "SwitchController"], request)
    except AttributeError:
        answer = ask(manager + "/switch_controller", [MANAGER + "SwitchController"], before_humble)
    understood(manager, answer)
    return "{}: active {}; inactive {}".format(manager, ", ".join(on) or "-", ", ".join(off) or "-")


def mode(ask: Ask, said: Mapping[str, Any]) -> str:
    """Ask a node, or a system, of system_modes for a mode."""
    node, name = said["name"], said["mode"]
    types = ["system_modes_msgs/srv/{}", "system_modes/srv/{}"]
    found = ask(node + "/get_mode", [one.format("GetMode") for one in types], {})
    if found.current_mode == name:
        return f"{node} is in mode {name} already"
    request = {"mode_name": name}
    answer = ask(node + "/change_mode", [one.format("ChangeMode") for one in types], request)
    understood(f"{node}, asked for mode {name},", answer)
    return f"{node} was in mode {found.current_mode}, and changes to {name}"


PARTS = "composition_interfaces/srv/"


def component(ask: Ask, said: Mapping[str, Any]) -> str:
    """Load a component into its container, unload it, or both: the restart of one node of a process."""
    container, verb, node = said["name"] + "/_container", said["verb"], said["node"]
    there = ask(container + "/list_nodes", [PARTS + "ListNodes"], {})
    ids = {name: there.unique_ids[index] for index, name in enumerate(there.full_node_names)}
    if verb == "load" and node in ids:
        return f"{node} is loaded already"
    if verb == "unload" and node not in ids:
        return f"{node} is not loaded"
    if verb != "load" and node in ids:
        answer = ask(container + "/unload_node", [PARTS + "UnloadNode"], {"unique_id": ids[node]})
        understood("{}, asked to unload {},".format(said["name"], node), answer)
    if verb != "unload":
        space, _, name = node.rpartition("/")
        request = {"package_name": said["package"], "plugin_name": said["plugin"], "node_name": name}
        answer = ask(
            container + "/load_node", [PARTS + "LoadNode"], {**request, "node_namespace": space or "/"}
        )
        understood("{}, asked to load {},".format(said["name"], node), answer)
    return "{}: {} of {} is done".format(said["name"], verb, node)


ASKED: dict[str, Callable[[Ask, dict[str, Any]], str]] = {
    "service": service,
    "parameter": parameter,
    "lifecycle": lifecycle,
    "controllers": controllers,
    "mode": mode,
    "component": component,
}


# --- ROS --------------------------------------------------------------------------------------------------


class Asking:
    """A node that asks services, all of them within a time."""

    def __init__(self, node: Any, rclpy: Any, within_s: float) -> None:
        self._node = node
        self._rclpy = rclpy
        self._within_s = within_s
        self._until_s = time.monotonic() + within_s

    def __call__(self, name: str, types: Sequence[str], request: Mapping[str, Any]) -> Any:
        kind = self._type(name, types)
        package, _, short = kind.split("/")
        try:
            cls = getattr(importlib.import_module(package + ".srv"), short)
        except (ImportError, AttributeError) as error:
            raise Ended(NOT_ASKED, f"{kind} is not built for this Python: {error}") from error
        filled = cls.Request()
        lists = {n: v for n, v in request.items() if isinstance(v, list) and v and not isinstance(v[0], str)}
        try:
            for field, value in lists.items():  # of messages
                setattr(filled, field, value)
            fill(filled, {n: v for n, v in request.items() if n not in lists})
        except (TypeError, ValueError, AssertionError) as error:
            raise Ended(NOT_ASKED, f"the request of {name} cannot be made: {error}") from error
        client = self._node.create_client(cls, name)
        while not client.wait_for_service(timeout_sec=LOOK_S):
            if time.monotonic() > self._until_s:
                raise Ended(NOBODY, f"nobody offers the service {name}")
        future = client.call_async(filled)
        self._rclpy.spin_until_future_complete(
            self._node, future, timeout_sec=max(LOOK_S, self._until_s - time.monotonic())
        )
        if not future.done():
            within = f"{name} does not answer within {self._within_s:g} s"
            raise Ended(NO_ANSWER, within + "; whether it acted is unknown")
        return future.result()

    def _type(self, name: str, types: Sequence[str]) -> str:
        """Return which of the types a service has."""
        found: list[str] = []
        until_s = min(self._until_s, time.monotonic() + FOUND_S)
        while time.monotonic() < until_s and not found:
            self._rclpy.spin_once(self._node, timeout_sec=LOOK_S)
            found = dict(self._node.get_service_names_and_types()).get(name, [])
        if not found:
            raise Ended(NOBODY, f"nobody offers the service {name}")
        fitting = [one for one in types if one in found]
        if not fitting:
            of = " and ".join(found)
            raise Ended(NOT_ASKED, f"{name} is of type {of}, not {types[0]}; it was not asked")
        return fitting[0]


def answered(said: dict[str, Any]) -> tuple[int, str]:
    """Ask; return the exit code and the sentence."""
    try:
        import rclpy
    except ImportError as error:
        why = f"{sys.executable} has no rclpy ({error})"
        return NOT_ASKED, f"{why}: source ROS's setup.bash before the agent, or name another under `python`"
    rclpy.init()
    node = rclpy.create_node("robomend_asking", enable_rosout=False, start_parameter_services=False)
    try:
        return DONE, ASKED[said["ask"]](Asking(node, rclpy, said["within_s"]), said)
    except Ended as ended:
        return ended.code, str(ended)
    except AttributeError as error:  # no such field
        return NOT_ASKED, "the request of {} cannot be made: {}".format(said["name"], error)
    finally:
        node.destroy_node()
        rclpy.shutdown()


def main() -> None:
    said: dict[str, Any] = json.loads(sys.argv[1])
    code, sentence = answered(said)
    told: dict[str, Any] = {"said": sentence}
    if "before" in said:
        told["before"] = said["before"]
    print("\n" + json.dumps(told), flush=True)
    sys.exit(code)


if __name__ == "__main__":
    main()
