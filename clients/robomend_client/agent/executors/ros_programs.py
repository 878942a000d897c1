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
from dataclasses import dataclass
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
from robomend_client.agent.executors.ros2_asking import CHANGES

LAUNCHERS = {"ros1": ("roslaunch",), "ros2": ("ros2", "launch")}

ASKING = Path(__file__).with_name("ros2_asking.py")
SYSTEM_PYTHON = Path("/usr/bin/python3")
"""ROS 2's own, where it was not built for another."""

CODES = (OK, FAILED, REFUSED, TIMED_OUT, UNREACHABLE)
"""What each exit code of ros2_asking.py means."""

SHARE = 0.8
"""Of an action's time that a node has for its answer: the rest is the program's own."""


class NodeAsking(ABC):
    """Asks a node of the robot for one thing. The first parameter says of which node, by a list.

    Attributes:
        name: the action, as the plan has it; by default the entry's name.
        timeout_s: how long it may take, in seconds; the robot's configuration at the service may say less or
            more.
    """

    gives_up = False  # the node goes on with it

    def __init__(
        self,
        name: str,
        asked: Mapping[str, str],
        key: str,
        parameters: Sequence[Sequence[str]] = (),
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

    @abstractmethod
    def said(self, parameters: Sequence[str]) -> dict[str, Any] | ActionResult:
        """Return what is asked for, as ros2_asking.py takes it, or why nothing is."""

    def would(self, parameters: Sequence[str]) -> str:
        """Return what would be sent, for people."""
        said = self.said(parameters)
        return said.message if isinstance(said, ActionResult) else would(said)


class Ros2Asking(NodeAsking):
    """Asks a node of ROS 2, by a program that the robot's own Python runs.

    Attributes:
        python: the Python that has rclpy; by default /usr/bin/python3.
    """

    def __init__(
        self,
        name: str,
        asked: Mapping[str, str],
        key: str,
        parameters: Sequence[Sequence[str]] = (),
        python: str | None = None,
        timeout_s: float = TAKES_S,
    ) -> None:
        super().__init__(name, asked, key, parameters, timeout_s)
        self._python = python
        self._environment: Mapping[str, str] = {}

    def attach(self, environment: Mapping[str, str]) -> None:
        """Be in the domain that the agent's file names."""
        self._environment = environment

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

    def was(self, parameters: Sequence[str], before: Any) -> None:  # most set nothing
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
            services: the action's first parameter → the service's full name.
            type: the service's type, such as std_srvs/srv/Trigger; of another it is not asked.
            request: field → value, dotted for messages in it; `{NAME}` stands for a parameter.
            parameters: name → what it may be, of further parameters, in the action's order.
        """
        self._request = ServiceRequest(type, "std_srvs/srv/Trigger", request, parameters)
        super().__init__(name, services, "services", self._request.lists, python, timeout_s)

    def said(self, parameters: Sequence[str]) -> dict[str, Any]:
        return self._request.said(self._asked[parameters[0]], parameters[1:])


class ServiceRequest:
    """The request of a service. `{NAME}` in a field's value stands for a parameter of the action."""

    def __init__(
        self,
        kind: str,
        like: str,
        fields: Mapping[str, str] | None,
        parameters: Mapping[str, Sequence[str]] | None,
    ) -> None:
        """
        Args:
            kind: the service's type.
            like: one that has the right parts, `std_srvs/srv/Trigger`.
            fields: field → value.
            parameters: name → what it may be.
        """
        parts, right = kind.split("/"), like.split("/")
        if len(parts) != len(right) or parts[1:-1] != right[1:-1]:
            raise ValueError(f"type must be as {like}, not {kind!r}")
        self._kind = kind
        self._names = tuple(parameters or {})
        self.lists = tuple((parameters or {}).values())
        self._fields = dict(fields or {})
        for value in self._fields.values():
            for place in PLACE.findall(value):
                if place not in self._names:
                    known = ", ".join(self._names) or "none"
                    raise ValueError(f"request has a place for {{{place}}}, but the parameters are: {known}")

    def said(self, service: str, parameters: Sequence[str]) -> dict[str, Any]:
        """Return what is asked for with these parameters."""
        values = dict(zip(self._names, parameters, strict=True))
        filled = {field: PLACE.sub(lambda at: values[at[1]], value) for field, value in self._fields.items()}
        return {"ask": "service", "name": service, "type": self._kind, "request": filled}


@dataclass(frozen=True)
class ParameterChange:
    """The words by which a node's parameter is changed: to a value, by a step, or back to what it was.

    Attributes:
        parameter: the parameter's name.
        values: the action's second parameter → the value that is set.
        steps: the same, → by how much a number is changed.
        back: the second parameter that sets it back to what it was before the agent changed it.
        least: what a step leads to at least.
        most: what a step leads to at most.
    """

    parameter: str
    values: Mapping[str, str] | None = None
    steps: Mapping[str, str] | None = None
    back: str | None = None
    least: float | None = None
    most: float | None = None

    def __post_init__(self) -> None:
        if not self.parameter:
            raise ValueError("parameter must be the name of a parameter")
        if not self.words:
            raise ValueError("values must map a word to a value, e.g. {low: 5, high: 30}")
        if len(set(self.words)) < len(self.words):
            raise ValueError("values, steps and back must have words of their own")
        try:
            steps = [float(by) for by in (self.steps or {}).values()]
        except ValueError:
            raise ValueError("steps must map a word to a number, e.g. {faster: 5}") from None
        if steps and (self.least is None or self.most is None or not self.least < self.most):
            raise ValueError("least and most must bound what steps lead to")

    @property
    def words(self) -> tuple[str, ...]:
        return (*(self.values or {}), *(self.steps or {}), *(() if self.back is None else (self.back,)))


class Before:
    """What a parameter of some nodes was before an action changed it, in memory and, where it is known, on
    disk.
    """

    def __init__(self, change: ParameterChange) -> None:
        self._change = change
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

    def said(self, node: str, word: str) -> dict[str, Any] | ActionResult:
        """Return what is to become of the parameter of a node, or why nothing is."""
        change = self._change
        said = {"ask": "parameter", "name": node, "parameter": change.parameter}
        if word == change.back:
            before = self._values.get(f"{node} {change.parameter}")
            if before is None:
                why = f"{change.parameter} of {node}: it was not changed by this agent"
                return ActionResult(REFUSED, why)
            return {**said, "value": before}
        if word in (change.steps or {}):
            by = float((change.steps or {})[word])
            return {**said, "by": by, "least": change.least, "most": change.most}
        return {**said, "value": (change.values or {})[word]}

    def note(self, node: str, word: str, before: Any) -> None:
        """Keep what it was first; that is known no more once it was set back."""
        of = f"{node} {self._change.parameter}"
        if word == self._change.back or before is None:
            self._values.pop(of, None)
        else:
            self._values.setdefault(of, before)
        if self._file is not None:
            temporary = self._file.with_suffix(".new")
            temporary.write_text(json.dumps(self._values))
            temporary.replace(self._file)


class SetParameter(Ros2Asking):
    """Sets a parameter of a node of ROS 2, and sets it back."""

    def __init__(
        self,
        name: str,
        nodes: Mapping[str, str],
        change: ParameterChange,
        python: str | None = None,
        timeout_s: float = TAKES_S,
    ) -> None:
        """
        Args:
            nodes: the action's first parameter → the node's full name.
        """
        super().__init__(name, nodes, "nodes", (change.words,), python, timeout_s)
        self.before = Before(change)

    def said(self, parameters: Sequence[str]) -> dict[str, Any] | ActionResult:
        return self.before.said(self._asked[parameters[0]], parameters[1])

    def was(self, parameters: Sequence[str], before: Any) -> None:
        self.before.note(self._asked[parameters[0]], parameters[1], before)


TRANSITIONS = (*CHANGES, "restart")


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
            nodes: the action's parameter → the node's full name.
            transition: configure, activate, deactivate or cleanup, or restart: down as far as it is up, and
                up again; by default the name's first word.
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
            managers: the action's parameter → the controller_manager's full name.
            activate: the controllers that are to be active after it.
            deactivate: the controllers that are to be inactive after it.
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
            nodes: the action's first parameter → the node's full name, or the system's.
            modes: what the action's second parameter may be.
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
            nodes: the action's parameter → the full name of the node that the component is.
            container: the full name of the container that it belongs to.
            package: the component's package.
            plugin: the component's class.
            verb: load, unload or restart; by default the name's first word.
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
