"""The agent's file as JSON Schema: what its reader asks for, noted while it reads texts that go each way."""

from __future__ import annotations

import inspect
from importlib.util import find_spec
from pathlib import Path

from robomend_client.agent.config import read_config
from robomend_client.agent.executors.kinds import KINDS
from robomend_client.agent.feeds import EXTRAS, FEEDS, NEEDS
from robomend_client.observers.schema import IN_A_FILE, by_kind, observer_schema, observing_sections
from robomend_client.yaml_schema import DRAFT, TEXT, Schema, asked

TEXTS = (
    """\
robot: r
service: {url: "http://127.0.0.1:1"}
bus: {listen: "tcp:127.0.0.1:0"}
processes:
  waits: {command: [a], ready: {output: up}, environment: {}}
  begins: {command: [a]}
""",
    """\
robot: r
service: {url: "http://127.0.0.1:1"}
bus: {join: "tcp:127.0.0.1:1"}
""",
)
"""Together they go every way that the reader can go."""

SAID: dict[str, str] = {
    "robot": "the robot's id at the service",
    "agent": "this agent's name; several agents of a robot have different ones",
    "host": "which of the model's hosts this is; a robot's only agent leaves it out",
    "service": "where the service is, and the key",
    "state_dir": "buffer, first results, table of processes; relative to this file",
    "bus": "where nodes hand their messages in: listen, or join another agent's",
    "report": "heartbeat_s, lifetime_s, buffer_mb",
    "when_agent_ends": "stop the processes, or keep them for the next agent",
    "processes": "the only ones that may be started and stopped, by the model's names of the nodes",
    "actions": "what else the agent can do, by the plan's names",
    "recording": "what the observers are fed with, as lines of JSON",
    "board": "the power board, as the service measures it",
    "ros1": "a robot with ROS 1",
    "ros2": "a robot with ROS 2",
}


def agent_schema() -> Schema:
    """Return the schema of the agent's file; what is not installed here may have any keys."""
    schema: Schema = {
        "$schema": DRAFT,
        "title": "robomend: an agent's file",
    }
    extras = "".join(f"{name}: {{}}\n" for name in ("ros1", "ros2") if _installed(name))
    for text in TEXTS:
        read_config(asked(text + extras, schema), Path())
    schema["type"] = "object"
    properties = schema["properties"]
    properties |= observing_sections()
    for name in FEEDS.names():
        if name not in properties:
            properties[name] = {"type": ["object", "null"]}
    properties["actions"] = {
        "type": ["object", "null"],
        "additionalProperties": {"$ref": "#/$defs/action"},
    }
    service, bus = properties["service"]["properties"], properties["bus"]["properties"]
    service["url"] = {"type": "string", "pattern": r"^https?://[^\s?#]+$"}
    for way in bus.values():
        way["pattern"] = "^(unix|tcp):"
    _forget_this_computer(properties)
    for name, said in SAID.items():
        properties[name] = {"description": said, **properties[name]}
    schema["$defs"] = {
        "observer": observer_schema(),
        "action": by_kind(KINDS, {"kind": TEXT}, IN_A_FILE, _given),
    }
    return schema


def _forget_this_computer(properties: Schema) -> None:
    """Drop the defaults that come from where the schema is made: its name, its folders, its environment."""
    properties["agent"].pop("default")
    places = {"bus": ("listen", "join"), "ros1": ("master",), "ros2": ("domain", "discovery")}
    for section, keys in places.items():
        for key in keys:
            properties[section].get("properties", {}).get(key, {}).pop("default", None)


def _installed(name: str) -> bool:
    return name not in EXTRAS or all(find_spec(module) is not None for module in NEEDS.get(name, ()))


def _given(make: object) -> frozenset[str]:
    assert callable(make)
    return frozenset({"base"} & inspect.signature(make).parameters.keys())
