"""The agent's file as JSON Schema: what its reader asks for, noted while it reads texts that go each way."""

from __future__ import annotations

import inspect
from pathlib import Path

from robomend_client.agent.config import TOP, read_config
from robomend_client.agent.executors.base import KINDS
from robomend_client.agent.feeds import FEEDS, BrokenFeed, MissingExtra, load_feed
from robomend_client.observers.schema import IN_A_FILE, by_kind, observer_schema, observing_sections
from robomend_client.yaml_reader import DRAFT, ConfigError, Schema, asked

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

HERE = {
    "bus": ("listen", "join"),
    "report": ("lifetime_s",),
    "ros1": ("master",),
    "ros2": ("domain", "discovery"),
    "zenoh": ("domain",),
}
"""Keys whose defaults come from where the schema is made, or from another key."""

KIND = "the kind of action, or FILE.py:NAME, a class of a file beside this one"


def agent_schema() -> Schema:
    """Return the schema of the agent's file; what is not installed here may have any keys."""
    schema: Schema = {
        "$schema": DRAFT,
        "title": "robomend: an agent's file",
    }
    for text in TEXTS:
        read_config(asked(text, schema), Path())
    schema["type"] = "object"
    properties = schema["properties"]
    properties |= observing_sections()
    properties |= {name: _feed_schema(name) for name in FEEDS.names()}
    properties["actions"] = {
        "description": TOP["actions"],
        "type": ["object", "null"],
        "additionalProperties": {"$ref": "#/$defs/action"},
    }
    service, bus = properties["service"]["properties"], properties["bus"]["properties"]
    service["url"] |= {"type": "string", "pattern": r"^https?://[^\s?#]+$"}
    for way in bus.values():
        way["pattern"] = "^(unix|tcp):"
    described = properties["starved"].pop("description")
    properties["starved"] = {"description": described, "anyOf": [properties["starved"], {"const": False}]}
    _forget_this_computer(properties)
    schema["$defs"] = {
        "observer": observer_schema(),
        "action": by_kind(KINDS, KIND, {}, IN_A_FILE, _given),
    }
    return schema


def _forget_this_computer(properties: Schema) -> None:
    """Drop the defaults that are none elsewhere: this computer's name, its folders, its environment."""
    properties["agent"].pop("default")
    for section, keys in HERE.items():
        for key in keys:
            properties[section].get("properties", {}).get(key, {}).pop("default", None)


def _feed_schema(name: str) -> Schema:
    """Return the section of a feed; any keys will do of one that is not installed here."""
    said = {"description": TOP[name]} if name in TOP else {}
    schema: Schema = {}
    try:
        feed = load_feed(name)
        said = said or {"description": _first_line(feed)}
        section = asked("{}", schema)
        feed(section, Path(), frozenset())
        section.finish()
    except (MissingExtra, BrokenFeed):
        return {**said, "type": ["object", "null"]}
    except ConfigError:  # it wants a key: others than it asked for before are let through
        return {**said, **schema}
    return {**said, **schema}


def _first_line(feed: object) -> str:
    return (inspect.getdoc(feed) or "").partition("\n")[0]


def _given(make: object) -> frozenset[str]:
    assert callable(make)
    return frozenset({"base"} & inspect.signature(make).parameters.keys())
