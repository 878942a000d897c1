"""The kinds of executors by name, and the section `actions:` of the agent's file.

    actions:
      calibrate: {kind: process, command: [/opt/robot/calibrate, "{arm}"], parameters: {arm: [left, right]}}
      reset_usb: {kind: reset_usb, devices: {camera: "046d:0825"}}

Its keys are the parameters of the executor's class (observers/parameters.py). Bridges and other
distributions add kinds by the entry points `robomend.agent_executors`; a class of one's own is named by its
file, `horn.py:Horn`, relative to the agent's.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from robomend_client.agent.executors.base import ActionExecutor
from robomend_client.observers.parameters import UnreadableParameter, made, read_arguments
from robomend_client.registry import BrokenKind, Registry, UnknownKind, load_of_file
from robomend_client.yaml_reader import Section

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
