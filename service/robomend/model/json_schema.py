"""The component model as JSON Schema, for editors: the keys of component_yaml.py, each with what it may be.

A schema knows the structure of one text. What a name refers to, circles of feeds, channels used twice and
the sentences of rules are beyond it; the reader has them, with file and line.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from robomend.model import component_yaml as keys
from robomend.model.clauses import UNKNOWN_MODE
from robomend.model.cnf import PARTIAL
from robomend.model.components import (
    CHANGES_PER_HOUR,
    DWELL_S,
    Component,
    Criticality,
    Hardware,
    Node,
)
from robomend.model.five_key import KEYS as FIVE_KEYS
from robomend_client.docstrings import documented
from robomend_client.yaml_reader import DRAFT

Schema = dict[str, Any]

SCALAR = ["string", "number", "boolean"]
NAME: Schema = {"type": SCALAR, "minLength": 1, "maxLength": keys.MAX_NAME + 1}
KEY_NAME: Schema = {"minLength": 1, "maxLength": keys.MAX_NAME + 1, "pattern": r"^[^\u0000-\u001f\u007f]+$"}
TEXT: Schema = {"type": [*SCALAR, "null"]}
NAMES: Schema = {"type": [*SCALAR, "array", "null"], "items": NAME, "uniqueItems": True}
SENTENCES: Schema = {"type": ["array", "null"], "items": {"type": SCALAR}}
FLAG: Schema = {"enum": [True, False, "yes", "no", "on", "off", None]}
OFF: Schema = {**FLAG, "default": False}
ABOVE_0: Schema = {"type": ["number", "null"], "exclusiveMinimum": 0}
PROBABILITY: Schema = {"type": ["number", "null"], "exclusiveMinimum": 0, "exclusiveMaximum": 1}
SECONDS: Schema = {"type": ["number", "null"], "minimum": 0, "maximum": keys.MOST_S}
CHANNEL: Schema = {"type": ["integer", "null"], "minimum": 0, "maximum": keys.MAX_CHANNELS - 1}

BY_TYPE: dict[str, Schema] = {
    "bool": FLAG,
    "int": {"type": ["integer", "null"], "minimum": 0, "maximum": keys.MAX_WHOLE},
    "float": ABOVE_0,
    "str": TEXT,
    "tuple[str, ...]": NAMES,
}
"""The fields of a kind of component that others add, as component_yaml.py reads them."""


def model_schema() -> Schema:
    """Return the schema of a model in YAML: a component model, or five keys."""
    return {
        "$schema": DRAFT,
        "title": "robomend: a model",
        "type": "object",
        "if": {"not": {"required": ["robomend"]}, "anyOf": [{"required": [key]} for key in FIVE_KEYS]},
        "then": five_key_schema(),
        "else": component_schema(),
    }


def component_schema() -> Schema:
    """Return the schema of a component model."""
    sections: Schema = {
        "hardware": _section(Hardware, HARDWARE),
        "nodes": _section(Node, NODE),
        **{kind.section: _section(kind, _own_keys(kind)) for kind in keys.OTHER_KINDS},
    }
    known: Schema = {**TOP, **sections}
    return {
        "type": "object",
        "properties": {key: known[key] for key in keys.MODEL_KEYS},
        "required": ["robomend"],
        "anyOf": [{"required": [section]} for section in sections],
        "additionalProperties": False,
    }


def five_key_schema() -> Schema:
    """Return the schema of a five-key model."""
    word: Schema = {"type": "string", "pattern": r"^\w[\w.-]*$"}
    texts: Schema = {"type": ["array", "null"], "items": {"type": SCALAR}}
    ab, nab, prefix, props, rules = FIVE_KEYS
    return {
        "properties": {
            ab: _said("the word for abnormal, e.g. AB in AB(laser)", word),
            nab: _said("the word for not abnormal, e.g. NAB in NAB(laser)", word),
            prefix: _said("before a negative literal, e.g. not_ in not_ok(scan)", word),
            props: _said("the propositions, e.g. ok(scan); NAB(imu) of a component that no rule has", texts),
            rules: _said('premises, an arrow and one literal or false: "NAB(laser),ok(t)->ok(u)"', texts),
        },
        "required": list(FIVE_KEYS),
        "additionalProperties": False,
    }


def _said(description: str, schema: Schema) -> Schema:
    return {"description": description, **schema}


def _named(entry: Schema, *, listed: bool = True) -> Schema:
    """Return a section: entries by name, or bare names."""
    shape: Schema = {"type": ["object", "null"], "propertyNames": KEY_NAME, "additionalProperties": entry}
    if listed:
        shape |= {"type": ["object", "array", "null"], "items": NAME, "uniqueItems": True}
    return shape


def _entry(properties: Schema, *required: str) -> Schema:
    entry: Schema = {"type": ["object", "null"], "properties": properties, "additionalProperties": False}
    return {**entry, "type": "object", "required": list(required)} if required else entry


MODES: Schema = {
    "type": ["object", "null"],
    "propertyNames": {**KEY_NAME, "not": {"const": UNKNOWN_MODE}},
    "additionalProperties": SENTENCES,
}
CRITICALITY: Schema = {"enum": [*map(str, Criticality), None], "default": str(Criticality.NORMAL)}
PART: Schema = {
    "prior": _said("the probability that it is abnormal, above 0 and below 1", PROBABILITY),
    "cost": _said("a factor on what the domain says that actions on it cost", {**ABOVE_0, "default": 1}),
    "modes": _said("fault mode → sentences that hold in it", MODES),
    "exhaustive_modes": _said("whether it cannot fail in any other way than by these modes", OFF),
    "host": _said(
        "the computer that it runs on or hangs on, by a name that an agent has as its host",
        {**NAME, "type": [*SCALAR, "null"]},
    ),
    "protected": _said("whether nothing may shut it down or stop it, nor what it cannot do without", OFF),
    "criticality": _said("how much the robot needs it", CRITICALITY),
    "helps": _said(
        "act (restart, power_cycle, or its name) → the probability that it cures, or one for each fault mode",
        {
            "type": ["object", "null"],
            "additionalProperties": {
                "anyOf": [
                    {**PROBABILITY, "type": "number"},
                    {"type": "object", "additionalProperties": {**PROBABILITY, "type": "number"}},
                ]
            },
        },
    ),
}
HARDWARE: Schema = {
    "channel": _said(
        "its channel of the power board, which can switch it; without one, nothing can", CHANNEL
    ),
    "fed_by": _said("devices whose power it needs, all of them", NAMES),
    "blame_hardware": _said("whether it can be blamed beside its drivers where it has no channel", FLAG),
    "boot_s": _said("how long it takes from its power to its answering, in seconds", SECONDS),
    "computer": _said(
        "whether it is a computer: topics of nodes with it as their `host` need ok(load,NAME)", OFF
    ),
    **PART,
}
NODE: Schema = {
    "drives": _said("the devices that it drives", NAMES),
    "publishes": _said("topic → the topics that it rests on", _named(NAMES)),
    "inputs_matter": _said("whether the inputs of a driver count, too", FLAG),
    "restartable": _said("whether it may be stopped and started", {**FLAG, "default": True}),
    "tied_to": _said("nodes after whose restart it must restart", NAMES),
    "start_s": _said(
        "how long it takes from its beginning to its topics, its inputs and devices being there, in seconds",
        SECONDS,
    ),
    "reconnects": _said("whether it needs no restart once its device has its power back", OFF),
    **PART,
}
TOPIC: Schema = {
    "rate_hz": _said("what the observers may expect, in messages per second", ABOVE_0),
    "tolerance_hz": _said("by how much the rate may differ, in messages per second", ABOVE_0),
    "silent": _said("whether its silence is by design, and blames nobody", OFF),
    "latched": _said("whether its last message is kept for those who come later", OFF),
    "cost": _said("of observing it, in seconds", {**ABOVE_0, "default": 1}),
}
PROPERTY: Schema = {"cost": TOPIC["cost"]}
VALUE: Schema = {
    "topic": _said("the topic whose messages have it", NAME),
    "field": _said("the way to it, e.g. twist.twist.angular.z", {"type": SCALAR}),
}
REMEDY: Schema = {
    "mends": _said(
        "the components that it makes good again; asked for each, where no parameter is given", NAMES
    ),
    "cost": _said("about the seconds until its effect can be seen", {**ABOVE_0, "default": 2}),
    "symptoms": _said(
        "the kinds of symptom that it helps against; by default any",
        {"type": ["array", "null"], "items": {"enum": list(keys.SYMPTOMS)}},
    ),
    "needs": _said("components that must be good before it is asked for", NAMES),
    "restarts": _said("nodes that must restart after it", NAMES),
    "starts": _said("whether it starts the nodes that it mends, which then need not run before", OFF),
}
VARIANT: Schema = {
    "when": _said('what OBS must show, e.g. "visibility >= 3.25 ± 0.1 and ok(image)"', TEXT),
    "needs": _said("components, functions or one variant of a function (function.variant)", NAMES),
    "do": _said('the acts that make it active, e.g. ["set_mode(spiral, high)"]', SENTENCES),
}
FUNCTION: Schema = {
    "prefer": _said("all variants, the best first; default: as they are written", NAMES),
    "variants": _said("the ways in which it may work", _named(_entry(VARIANT))),
    "dwell_s": _said(
        "how long a better variant must be admissible before it is changed to, in seconds",
        {**SECONDS, "default": DWELL_S},
    ),
    "adapt": _said("who decides on a change; default: the robot's policy", {"enum": [*keys.ADAPT, None]}),
    "changes_per_hour": _said(
        "after so many changes in an hour it stays with the safer variant",
        {
            "type": ["integer", "null"],
            "minimum": 1,
            "maximum": keys.MAX_WHOLE,
            "default": CHANGES_PER_HOUR,
        },
    ),
    "criticality": PART["criticality"],
    "notify": _said("whether people are told of changes", OFF),
}
TOP: Schema = {
    "robomend": _said("the version of this format", {"const": keys.FORMAT}),
    "name": _said("the robot model's name; default: the file's", TEXT),
    "channels": _said(
        "how many the power board has",
        {"type": ["integer", "null"], "minimum": 1, "maximum": keys.MAX_CHANNELS, "default": 10},
    ),
    "protected_channels": _said(
        "channels that are never shut down, e.g. the one of the robot's computer",
        {"type": ["array", "null"], "items": {**CHANNEL, "type": "integer"}},
    ),
    "topics": _said("topics from outside, and what observers expect of all", _named(_entry(TOPIC))),
    "properties": _said("observable things that are neither topic nor component", _named(_entry(PROPERTY))),
    "values": _said(
        "fields whose trends are observed", _named(_entry(VALUE, *keys.VALUE_KEYS), listed=False)
    ),
    "related": _said(
        "pairs of values whose trends match",
        {
            "type": ["array", "null"],
            "items": {"type": "array", "items": NAME, "minItems": 2, "maxItems": 2, "uniqueItems": True},
        },
    ),
    "rules": _said('your own, e.g. "not ok(temp) -> ab(mapper)"', SENTENCES),
    "functions": _said(
        "what the robot does in one of several variants", _named(_entry(FUNCTION, "variants"), listed=False)
    ),
    "remedies": _said(
        "acts besides restarts and power, `clear_costmap` or `set_mode(spiral, low)`, and what each mends",
        _named(_entry(REMEDY, "mends"), listed=False),
    ),
    "act_when": _said("nothing is sent to the robot unless this sentence is observed", TEXT),
    "blame_hardware": _said("what every device has that does not say it itself", OFF),
    "inputs_matter": _said("what every node has that does not say it itself", OFF),
    "partial_failure": _said(
        "the probability that what fails does so in part only", {**PROBABILITY, "default": PARTIAL}
    ),
}


def _own_keys(kind: type[Component]) -> Schema:
    said = documented(kind)
    own = (one for one in fields(kind) if one.name not in keys.COMMON_FIELDS)
    types = {one.name: BY_TYPE[str(one.type).removesuffix(" | None")] for one in own}
    return {**{key: _said(said[key], one) if key in said else one for key, one in types.items()}, **PART}


def _section(kind: type[Component], properties: Schema) -> Schema:
    return _said(f"the robot's {kind.section}, by name", _named(_entry(properties)))
