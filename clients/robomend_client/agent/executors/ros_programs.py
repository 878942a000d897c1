"""The kinds that need ROS's own programs: what nodes of ROS 2 are asked for, and launch files.

    clear_costmap: {kind: ros2_service, services: {planner: /planner_server/clear}, type: std_srvs/srv/Empty}
    set_fps: {kind: ros2_parameter, nodes: {camera: /camera}, parameter: fps, values: {low: 5, high: 30}}
    bring_up: {kind: lifecycle, nodes: {camera_node: /camera}, transition: restart}
    calibrate: {kind: launch, package: arm, file: calibrate.launch, arguments: {side: "{arm}"},
                parameters: {arm: [left, right]}}

Services of ROS 2 are asked by ros2_asking.py, which the robot's own Python runs with its own ROS: over DDS
each vendor has replies of its own. A launch file that goes on running belongs under `processes:`, whose
command may be [roslaunch, …] or [ros2, launch, …]: stopped, all of it is ended.
"""

from __future__ import annotations

import json
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from robomend_client.actions import (
    FAILED,
    OK,
    REFUSED,
    TIMED_OUT,
    UNREACHABLE,
    Action,
    ActionResult,
    Feedback,
)
from robomend_client.agent.executors.program import PLACE, QUOTED, TAKES_S, Program, ended

LAUNCHERS = {"ros1": ("roslaunch",), "ros2": ("ros2", "launch")}

ASKING = Path(__file__).with_name("ros2_asking.py")
SYSTEM_PYTHON = Path("/usr/bin/python3")
"""ROS 2's own, where it was not built for another."""

CODES = (OK, FAILED, REFUSED, TIMED_OUT, UNREACHABLE)
"""What each exit code of ros2_asking.py means."""

SHARE = 0.8
"""Of an action's time that a node has for its answer: the rest is the program's own."""


class Ros2Asking(ABC):
    """Asks a node of ROS 2 for one thing. The first parameter says of which node, by a list."""

    gives_up = False  # the node goes on with it

    def __init__(
        self,
        name: str,
        asked: Mapping[str, str],
        key: str,
        parameters: Sequence[Sequence[str]] = (),
        python: str | None = None,
        timeout_s: float = TAKES_S,
    ) -> None:
        """`asked` is the section `key` of the file: parameter → full name of what is asked."""
        if not asked:
            raise ValueError(f"{key} must map a parameter to a full name, e.g. {{camera_node: /camera}}")
        for full in asked.values():
            if not full.startswith("/"):
                raise ValueError(f"{key}: {full!r} must be a full name, with its slash")
        if not timeout_s > 0:
            raise ValueError("timeout_s must be above 0")
        self.name = name
        self.takes_s = timeout_s
        self.parameters = (tuple(asked), *map(tuple, parameters))
        self._asked = {one: full.rstrip("/") for one, full in asked.items()}
        self._python = python
        self._environment: Mapping[str, str] = {}

    def attach(self, environment: Mapping[str, str]) -> None:
        """Be in the domain that the agent's file names."""
        self._environment = environment

    @abstractmethod
    def said(self, parameters: Sequence[str]) -> dict[str, Any] | ActionResult:
        """Return what ros2_asking.py is asked for, or why nothing is."""

    def would(self, parameters: Sequence[str]) -> str:
        """Return what would be sent, for people."""
        said = self.said(parameters)
        return said.message if isinstance(said, ActionResult) else would(said)

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        said = self.said(action.parameters)
        if isinstance(said, ActionResult):
            return said
        feedback(1, f"{action}: {would(said)}")
        found = {**said, "within_s": action.timeout_s * SHARE}
        command = [self._python or python(), str(ASKING), json.dumps(found)]
        try:
            code, tail = await ended(command, str(action), feedback, environment=self._environment)
        except OSError as error:
            return ActionResult(UNREACHABLE, f"{command[0]} cannot be started: {error}")
        try:
            told = json.loads(tail.rpartition("\n")[2])
            sentence = str(told["said"])
        except (ValueError, KeyError, TypeError):
            return ActionResult(FAILED, f"{action}: exit code {code}; its last output: {tail[-QUOTED:]}")
        if "before" in told:
            self.was(action.parameters, told["before"])
        return ActionResult(CODES[code] if 0 <= code < len(CODES) else FAILED, sentence)

    def was(self, parameters: Sequence[str], before: Any) -> None:  # noqa: B027  # most set nothing
        """Note what it was that has been set."""


def python() -> str:
    """Return the Python that has rclpy, where the file does not say it."""
    named = os.environ.get("ROBOMEND_RCLPY_PYTHON")
    return named or (str(SYSTEM_PYTHON) if SYSTEM_PYTHON.exists() else "python3")


def would(said: Mapping[str, Any]) -> str:
    """Return a request in words."""
    name = said["name"]
    match said["ask"]:
        case "service":
            fields = ", ".join(f"{field}: {value}" for field, value in said["request"].items())
            return f"the service {name} ({said['type']}) is called with {{{fields}}}"
        case "parameter" if "by" in said:
            return f"the parameter {said['parameter']} of {name} is changed by {said['by']:+g}"
        case "parameter":
            return f"the parameter {said['parameter']} of {name} is set to {said['value']}"
        case "lifecycle":
            up = said["transition"] == "restart"
            return f"{name} is {'brought up again' if up else 'asked to ' + said['transition']}"
        case "controllers":
            on, off = (", ".join(said[key]) or "nothing" for key in ("activate", "deactivate"))
            return f"{name} activates {on} and deactivates {off}"
        case "mode":
            return f"{name} is asked for mode {said['mode']}"
    return f"{name} is asked to {said['verb']} {said['node']}"


class CallService(Ros2Asking):
    """Calls a service of ROS 2."""

    def __init__(
        self,
        name: str,
        services: Mapping[str, str],
        type: str,
        request: Mapping[str, str] | None = None,
        parameters: Mapping[str, Sequence[str]] | None = None,
        python: str | None = None,
        timeout_s: float = TAKES_S,
    ) -> None:
        """
        Args:
            name: the action, as the plan has it; by default the entry's name.
            services: the action's first parameter → the service's full name.
            type: the service's type, such as std_srvs/srv/Trigger; of another it is not asked.
            request: field → value, dotted for messages in it; `{NAME}` stands for a parameter.
            parameters: name → what it may be, of further parameters, in the action's order.
            python: the Python that has rclpy; by default /usr/bin/python3.
            timeout_s: how long it may take, in seconds; the robot's configuration at the service may say less
                or more.
        """
        super().__init__(name, services, "services", tuple((parameters or {}).values()), python, timeout_s)
        if type.count("/") != 2 or "/srv/" not in type:
            raise ValueError(f"type must be as std_srvs/srv/Trigger, not {type!r}")
        self._type = type
        self._names = tuple(parameters or {})
        self._request = checked_places(request or {}, self._names)

    def said(self, parameters: Sequence[str]) -> dict[str, Any]:
        values = dict(zip(self._names, parameters[1:], strict=True))
        filled = {field: PLACE.sub(lambda at: values[at[1]], value) for field, value in self._request.items()}
        return {
            "ask": "service", "name": self._asked[parameters[0]], "type": self._type, "request": filled
        }  # fmt: skip


def checked_places(request: Mapping[str, str], names: Sequence[str]) -> dict[str, str]:
    """Return the request, if it has places for these parameters only.

    Raises:
        ValueError: it has others.
    """
    for value in request.values():
        for place in PLACE.findall(value):
            if place not in names:
                known = ", ".join(names) or "none"
                raise ValueError(f"request has a place for {{{place}}}, but the parameters are: {known}")
    return dict(request)


class Before:
    """What parameters were before an action changed them, in memory and, where it is known, on disk."""

    def __init__(self) -> None:
        self._file: Path | None = None
        self._values: dict[str, Any] = {}

    def keep_in(self, folder: Path) -> None:
        """Go on from what is in this folder."""
        self._file = folder / "parameters-before.json"
        try:
            found = json.loads(self._file.read_text())
        except (OSError, ValueError):
            return
        if isinstance(found, dict):
            self._values = found

    def get(self, of: str) -> Any:
        return self._values.get(of)

    def note(self, of: str, value: Any) -> None:
        """Keep what it was first; it is known no more once it was put back."""
        if value is None:
            self._values.pop(of, None)
        else:
            self._values.setdefault(of, value)
        if self._file is not None:
            temporary = self._file.with_suffix(".new")
            temporary.write_text(json.dumps(self._values))
            temporary.replace(self._file)


class ParameterWays:
    """The words by which a parameter is changed: to a value, by a step, or back to what it was."""

    def __init__(
        self,
        values: Mapping[str, str],
        steps: Mapping[str, str],
        back: str | None,
        least: float | None,
        most: float | None,
    ) -> None:
        self.words = (*values, *steps, *(() if back is None else (back,)))
        if not self.words:
            raise ValueError("values must map a word to a value, e.g. {low: 5, high: 30}")
        if len(set(self.words)) < len(self.words):
            raise ValueError("values, steps and back must have words of their own")
        try:
            self._steps = {word: float(by) for word, by in steps.items()}
        except ValueError:
            raise ValueError("steps must map a word to a number, e.g. {faster: 5}") from None
        if steps and (least is None or most is None or not least < most):
            raise ValueError("least and most must bound what steps lead to")
        self._values, self._back = dict(values), back
        self._bounds = {"least": least, "most": most}

    def request(self, word: str, before: Any) -> dict[str, Any] | str:
        """Return what is to become of the parameter, or why nothing is."""
        if word == self._back:
            return "it was not changed by this agent" if before is None else {"value": before}
        if word in self._steps:
            return {"by": self._steps[word], **self._bounds}
        return {"value": self._values[word]}

    def back(self, word: str) -> bool:
        return word == self._back


class SetParameter(Ros2Asking):
    """Sets a parameter of a node of ROS 2, and sets it back."""

    def __init__(
        self,
        name: str,
        nodes: Mapping[str, str],
        parameter: str,
        values: Mapping[str, str] | None = None,
        steps: Mapping[str, str] | None = None,
        back: str | None = None,
        least: float | None = None,
        most: float | None = None,
        python: str | None = None,
        timeout_s: float = TAKES_S,
    ) -> None:
        """
        Args:
            name: the action, as the plan has it; by default the entry's name.
            nodes: the action's first parameter → the node's full name.
            parameter: the parameter's name.
            values: the action's second parameter → the value that is set.
            steps: the same, → by how much a number is changed.
            back: the second parameter that sets it back to what it was before the agent changed it.
            least: what a step leads to at least.
            most: what a step leads to at most.
            python: the Python that has rclpy; by default /usr/bin/python3.
            timeout_s: how long it may take, in seconds; the robot's configuration at the service may say less
                or more.
        """
        self._ways = ParameterWays(values or {}, steps or {}, back, least, most)
        super().__init__(name, nodes, "nodes", (self._ways.words,), python, timeout_s)
        if not parameter:
            raise ValueError("parameter must be the name of a parameter")
        self._parameter = parameter
        self.before = Before()

    def said(self, parameters: Sequence[str]) -> dict[str, Any] | ActionResult:
        node = self._asked[parameters[0]]
        found = self._ways.request(parameters[1], self.before.get(f"{node} {self._parameter}"))
        if isinstance(found, str):
            return ActionResult(REFUSED, f"{self._parameter} of {node}: {found}")
        return {"ask": "parameter", "name": node, "parameter": self._parameter, **found}

    def was(self, parameters: Sequence[str], before: Any) -> None:
        of = f"{self._asked[parameters[0]]} {self._parameter}"
        self.before.note(of, None if self._ways.back(parameters[1]) else before)


TRANSITIONS = ("configure", "activate", "deactivate", "cleanup", "restart")


class Lifecycle(Ros2Asking):
    """Makes one change of the lifecycle of nodes, or brings them up again."""

    def __init__(
        self,
        name: str,
        nodes: Mapping[str, str],
        transition: str | None = None,
        python: str | None = None,
        timeout_s: float = TAKES_S,
    ) -> None:
        """
        Args:
            name: the action, as the plan has it; by default the entry's name.
            nodes: the action's parameter → the node's full name.
            transition: configure, activate, deactivate or cleanup, or restart: down as far as it is up, and
                up again; by default the name's first word.
            python: the Python that has rclpy; by default /usr/bin/python3.
            timeout_s: how long it may take, in seconds; the robot's configuration at the service may say less
                or more.
        """
        super().__init__(name, nodes, "nodes", (), python, timeout_s)
        transition = transition or name.partition("_")[0]
        if transition not in TRANSITIONS:
            raise ValueError(f"transition must be one of {', '.join(TRANSITIONS)}, not {transition!r}")
        self._transition = transition

    def said(self, parameters: Sequence[str]) -> dict[str, Any]:
        return {"ask": "lifecycle", "name": self._asked[parameters[0]], "transition": self._transition}


class SwitchControllers(Ros2Asking):
    """Switches controllers of a controller_manager."""

    def __init__(
        self,
        name: str,
        managers: Mapping[str, str],
        activate: Sequence[str] = (),
        deactivate: Sequence[str] = (),
        python: str | None = None,
        timeout_s: float = TAKES_S,
    ) -> None:
        """
        Args:
            name: the action, as the plan has it; by default the entry's name.
            managers: the action's parameter → the controller_manager's full name.
            activate: the controllers that are to be active after it.
            deactivate: the controllers that are to be inactive after it.
            python: the Python that has rclpy; by default /usr/bin/python3.
            timeout_s: how long it may take, in seconds; the robot's configuration at the service may say less
                or more.
        """
        super().__init__(name, managers, "managers", (), python, timeout_s)
        if not (activate or deactivate):
            raise ValueError("activate must name controllers, or deactivate")
        if set(activate) & set(deactivate):
            raise ValueError("deactivate must not name what activate does")
        self._switch = {"activate": list(activate), "deactivate": list(deactivate)}

    def said(self, parameters: Sequence[str]) -> dict[str, Any]:
        return {"ask": "controllers", "name": self._asked[parameters[0]], **self._switch}


class ChangeMode(Ros2Asking):
    """Asks a node, or a system, of system_modes for a mode."""

    def __init__(
        self,
        name: str,
        nodes: Mapping[str, str],
        modes: Sequence[str],
        python: str | None = None,
        timeout_s: float = TAKES_S,
    ) -> None:
        """
        Args:
            name: the action, as the plan has it; by default the entry's name.
            nodes: the action's first parameter → the node's full name, or the system's.
            modes: what the action's second parameter may be.
            python: the Python that has rclpy; by default /usr/bin/python3.
            timeout_s: how long it may take, in seconds; the robot's configuration at the service may say less
                or more.
        """
        super().__init__(name, nodes, "nodes", (modes,), python, timeout_s)
        if not modes:
            raise ValueError("modes must list modes, e.g. [NORMAL, SLOW]")

    def said(self, parameters: Sequence[str]) -> dict[str, Any]:
        return {"ask": "mode", "name": self._asked[parameters[0]], "mode": parameters[1]}


VERBS = ("load", "unload", "restart")


class LoadComponent(Ros2Asking):
    """Loads a component into its container, unloads it, or both."""

    def __init__(
        self,
        name: str,
        nodes: Mapping[str, str],
        container: str,
        package: str = "",
        plugin: str = "",
        verb: str | None = None,
        python: str | None = None,
        timeout_s: float = TAKES_S,
    ) -> None:
        """
        Args:
            name: the action, as the plan has it; by default the entry's name.
            nodes: the action's parameter → the full name of the node that the component is.
            container: the full name of the container that it belongs to.
            package: the component's package.
            plugin: the component's class.
            verb: load, unload or restart; by default the name's first word.
            python: the Python that has rclpy; by default /usr/bin/python3.
            timeout_s: how long it may take, in seconds; the robot's configuration at the service may say less
                or more.
        """
        super().__init__(name, nodes, "nodes", (), python, timeout_s)
        verb = verb or name.partition("_")[0]
        if verb not in VERBS:
            raise ValueError(f"verb must be one of {', '.join(VERBS)}, not {verb!r}")
        if not container.startswith("/"):
            raise ValueError(f"container: {container!r} must be a full name, with its slash")
        if verb != "unload" and not (package and plugin):
            raise ValueError("plugin must be named, with its package, to be loaded")
        self._said = {"name": container.rstrip("/"), "verb": verb, "package": package, "plugin": plugin}

    def said(self, parameters: Sequence[str]) -> dict[str, Any]:
        return {"ask": "component", "node": self._asked[parameters[0]], **self._said}


class Launch(Program):
    """Runs a launch file to its end."""

    def __init__(
        self,
        name: str,
        package: str,
        file: str,
        base: Path,
        release: str = "ros2",
        arguments: Mapping[str, str] | None = None,
        parameters: Mapping[str, Sequence[str]] | None = None,
        gives_up: bool = False,
        timeout_s: float = TAKES_S,
    ) -> None:
        """
        Args:
            name: the action, as the plan has it; by default the entry's name.
            package: the ROS package that has the launch file.
            file: the launch file's name.
            base: the folder of the agent's file.
            release: ros1 (roslaunch) or ros2 (ros2 launch).
            arguments: the launch file's own, name → value; `{NAME}` stands for a parameter.
            parameters: name → what it may be, in the order in which the action has them.
            gives_up: whether one that is cut off leaves things as they were.
            timeout_s: how long it may take, in seconds; the robot's configuration at the service may say less
                or more.
        """
        if release not in LAUNCHERS:
            raise ValueError(f"release must be one of {', '.join(LAUNCHERS)}, not {release!r}")
        for key, word in (("package", package), ("file", file)):
            if not word or word.startswith("-"):
                raise ValueError(f"{key} must be a name, not {word!r}")
        given = [f"{key}:={value}" for key, value in (arguments or {}).items()]
        command = [*LAUNCHERS[release], package, file, *given]
        super().__init__(name, command, base, parameters, gives_up=gives_up, timeout_s=timeout_s)
