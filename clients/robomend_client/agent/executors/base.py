"""The shape of the agent's executors, and the table that finds the right one for an action.

An executor acts under one name, and each parameter is one of a list: what is not on it is refused, whatever
it is, and no shell ever reads it. To add a kind: a class of this shape in a file here, a line in KINDS,
its row in docs/agent.md.

The section `actions:` of the agent's file:

    actions:
      calibrate: {kind: process, command: [/opt/robot/calibrate, "{arm}"], parameters: {arm: [left, right]}}
      reset_usb: {kind: reset_usb, devices: {camera: "046d:0825"}}

Its keys are the parameters of the executor's class (observers/parameters.py). Bridges and other
distributions add kinds by the entry points `robomend.agent_executors`; a class of one's own is named by its
file, `horn.py:Horn`, relative to the agent's.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import prod
from pathlib import Path
from typing import Protocol

from robomend_client.actions import BY_COMPONENT, REFUSED, Action, ActionResult, Feedback, on
from robomend_client.observers.parameters import UnreadableParameter, made, read_arguments
from robomend_client.registry import BrokenKind, Registry, UnknownKind, load_of_file
from robomend_client.yaml_reader import Section

MOST_OFFERED = 1000
"""Choices of parameters that are offered one by one; with more of them the name alone."""


class ActionExecutor(Protocol):
    """Carries out the actions of one name.

    One may have `takes_s` as well: within how many seconds it answers, or that of each of its parameters.
    """

    @property
    def name(self) -> str:
        """The action, as the plan has it."""
        ...

    @property
    def parameters(self) -> Sequence[Sequence[str]]:
        """What each parameter may be."""
        ...

    @property
    def gives_up(self) -> bool:
        """Whether an action that was withdrawn may be left half-way: it leaves things as they were."""
        ...

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        """Act. Bounded by `action.timeout_s` from outside; cancelled, it leaves nothing running."""
        ...


class Executors:
    """All of one agent."""

    def __init__(self, agent: str, executors: Iterable[ActionExecutor]) -> None:
        self._agent = agent
        self._by_name: dict[str, list[ActionExecutor]] = {}
        for executor in executors:
            self._by_name.setdefault(executor.name, []).append(executor)

    def __iter__(self) -> Iterator[ActionExecutor]:
        return (executor for executors in self._by_name.values() for executor in executors)

    @property
    def names(self) -> tuple[str, ...]:
        """The actions that any of them carries out."""
        return tuple(self._by_name)

    @property
    def can(self) -> list[str]:
        """What the poll says: `name:parameter,parameter` of all that may be asked, of a drill's actions the
        first one, their component; the name alone where there are none, or too many.
        """
        found: dict[str, None] = {}
        for name, executors in self._by_name.items():
            for executor in executors:
                lists = executor.parameters[:1] if name in BY_COMPONENT else executor.parameters
                if lists and prod(map(len, lists)) <= MOST_OFFERED:
                    found.update((f"{name}:{on(name, values)}", None) for values in product(*lists))
                else:
                    found[name] = None
        return list(found)

    @property
    def takes_s(self) -> dict[str, float]:
        """What the poll says of how long an answer may take: of a name, or of `name:parameter`; of whose
        executor has no `takes_s` nothing is known.
        """
        found: dict[str, float] = {}
        for executor in self:
            said: float | Mapping[str, float] = getattr(executor, "takes_s", {})
            by = said if isinstance(said, Mapping) else {"": said}
            for parameter, seconds in by.items():
                key = f"{executor.name}:{parameter}" if parameter else executor.name
                found[key] = max(seconds, found.get(key, 0.0))
        return found

    def find(self, action: Action) -> ActionExecutor | ActionResult:
        """Return who carries out `action`, or why nobody here may."""
        executors = self._by_name.get(action.name)
        if executors is None:
            known = ", ".join(self._by_name) or "nothing"
            return _refused(f"agent {self._agent} knows no {action.name}; it knows {known}")
        for executor in executors:
            if len(executor.parameters) == len(action.parameters) and all(
                value in allowed
                for value, allowed in zip(action.parameters, executor.parameters, strict=True)
            ):
                return executor
        lists = [
            " with ".join(", ".join(allowed) for allowed in e.parameters) or "no parameter" for e in executors
        ]
        return _refused(
            f"agent {self._agent}: {action} is not allowed; configured are: {'; or '.join(lists)}"
        )


def _refused(message: str) -> ActionResult:
    return ActionResult(REFUSED, message)


ROOM = "robomend_client.agent.executors"


KINDS = Registry[Callable[..., ActionExecutor]](
    "kind of action",
    "robomend.agent_executors",
    {
        "process": f"{ROOM}.program:Program",
        "systemd": f"{ROOM}.systemd:Units",
        "ros2_service": f"{ROOM}.ros_programs:CallService",
        "ros2_parameter": f"{ROOM}.ros_programs:SetParameter",
        "lifecycle": f"{ROOM}.ros_programs:Lifecycle",
        "controllers": f"{ROOM}.ros_programs:SwitchControllers",
        "mode": f"{ROOM}.ros_programs:ChangeMode",
        "component": f"{ROOM}.ros_programs:LoadComponent",
        "launch": f"{ROOM}.ros_programs:Launch",
        "reset_usb": f"{ROOM}.usb:ResetUsb",
        "medkit": "robomend_client.bridges.medkit.restart:Restart",
        "ros1_service": "robomend_client.bridges.ros1.asking:CallRos1Service",
        "ros1_parameter": "robomend_client.bridges.ros1.asking:SetRos1Parameter",
        "ros_action": "robomend_client.bridges.ros1.actions:RosAction",
    },
)


PARTS = ("name", "parameters", "gives_up", "execute")
"""What an executor must have (base.ActionExecutor)."""


@dataclass(frozen=True)
class ActionSpec:
    """An action that the agent's file describes."""

    name: str
    kind: str
    make: Callable[[], ActionExecutor]


def read_actions(top: Section, base: Path) -> tuple[ActionSpec, ...]:
    """Return the actions in the section `actions:` of a file in the folder `base`.

    Raises:
        ConfigError: with file, line and key.
    """
    return tuple(_read_action(name, section, base) for name, section in top.sections("actions"))


def _read_action(name: str, section: Section, base: Path) -> ActionSpec:
    kind = section.text("kind")
    try:
        make = load_of_file(KINDS, kind, base)
        given = {"base": base} if "base" in inspect.signature(make).parameters else {}
        arguments = read_arguments(section, make, None, name, frozenset(given)) | given
        section.finish()
        executor = made(section, make, **arguments)
    except (UnknownKind, BrokenKind, UnreadableParameter) as error:
        raise section.error("kind", str(error.args[0])) from error
    if lacking := [part for part in PARTS if not hasattr(executor, part)]:
        raise section.error("kind", f"{kind} has no {', '.join(lacking)}")
    return ActionSpec(name, kind, lambda: make(**arguments))
