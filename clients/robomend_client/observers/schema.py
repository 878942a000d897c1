"""The sections `observers:` and `topics:` as JSON Schema, read off the same signatures as the file is."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, get_args, get_type_hints

from robomend_client.docstrings import documented
from robomend_client.observers import kinds
from robomend_client.observers.parameters import (
    UnreadableParameter,
    alternatives,
    dataclass_of,
    is_list,
    parameters_of,
    read_value,
    spread_dataclasses,
)
from robomend_client.observers.rate import Rate
from robomend_client.registry import BrokenKind, Registry
from robomend_client.yaml_reader import DRAFT, TEXT, ConfigError, Schema, asked_for_all

PRESET = "a set of defaults; `published` has the numbers of the released system, without its bugs"

IN_A_FILE = r"\.py:[^:]+$"
"""A kind of one's own: FILE.py:NAME."""

FROM: Schema = {"description": "who feeds it: bus, ros1, ros2, …", **TEXT, "default": kinds.BUS}
KIND = "the kind of observer, or FILE.py:NAME, a class or function of a file beside this one"


def observers_file_schema() -> Schema:
    """Return the schema of a file for batch: an agent's, or one of observers only."""
    sections = observing_sections()
    return {
        "$schema": DRAFT,
        "title": "robomend: observers",
        "type": "object",
        "if": {"anyOf": [{"required": [name]} for name in sections]},
        "then": {"properties": sections},
        "else": {"additionalProperties": {"$ref": "#/$defs/observer"}},
        "$defs": {"observer": observer_schema()},
    }


def observing_sections() -> Schema:
    """Return the sections of an agent's file that say what is observed; they refer to `#/$defs/observer`."""
    return {
        "rate": {"description": "what all topics have in common", **rate_schema()},
        "topics": {
            "type": ["object", "null"],
            "description": "topic → what is expected of the rate of its messages: reported as ok(topic)",
            "additionalProperties": rate_schema(),
        },
        "observers": {
            "type": ["object", "null"],
            "description": "name → kind and its keys",
            "additionalProperties": {"$ref": "#/$defs/observer"},
        },
        "lenient": {
            "type": "array",
            "items": TEXT,
            "description": "atoms of which good news wins where observers disagree",
        },
    }


def rate_schema() -> Schema:
    """Return what may be said of a topic."""
    preset = {"description": PRESET, "enum": ["none", *Rate.PRESETS], "default": "none"}
    return {
        "type": ["object", "null"],
        "properties": {**fields_schema(Rate), "preset": preset, "from": FROM},
        "additionalProperties": False,
    }


def observer_schema() -> Schema:
    """Return one entry of `observers:`; one of a FILE.py may have any keys."""
    return by_kind(kinds.KINDS, KIND, {"from": FROM}, IN_A_FILE)


def by_kind(
    registry: Registry[Any],
    what: str,
    everywhere: Schema,
    others: str | None = None,
    given: Callable[[Callable[..., Any]], frozenset[str]] = lambda _: frozenset(),
) -> Schema:
    """Return the entries whose keys go by their `kind`.

    Args:
        what: the description of `kind`.
        everywhere: keys that each kind has beside it.
        others: what kinds that are in no registry look like.
        given: the parameters that no file says.
    """
    known = {"enum": list(registry.names())}
    kind: Schema = known if others is None else {"anyOf": [known, {"type": "string", "pattern": others}]}
    kind = {"description": what, **kind}
    cases = []
    for name in registry.names():
        try:
            make = registry.load(name)
            case = kind_schema(make, given(make))
        except (BrokenKind, UnreadableParameter):
            continue
        case["properties"] = {"kind": {"description": what, **TEXT}, **everywhere, **case["properties"]}
        if named := preset_names(make):
            case["properties"]["preset"] = {"description": PRESET, "enum": named}
        cases.append({"if": {"properties": {"kind": {"const": name}}, "required": ["kind"]}, "then": case})
    return {"type": "object", "required": ["kind"], "properties": {"kind": kind}, "allOf": cases}


def preset_names(make: Callable[..., Any]) -> list[str]:
    """Return the names of the presets that a kind has."""
    if not inspect.isclass(make):
        return []
    return sorted({name for spread in spread_dataclasses(make) for name in getattr(spread, "PRESETS", {})})


def kind_schema(make: Callable[..., Any], given: frozenset[str] = frozenset()) -> Schema:
    """Return the keys of one kind, as read_arguments asks for them.

    Raises:
        UnreadableParameter: a parameter has no type, or one that no file can hold.
    """
    properties: Schema = {}
    required: list[str] = []
    said = documented(make)
    wanted = list(parameters_of(make))
    if not inspect.isclass(make):
        wanted = wanted[1:]  # the reading that a function judges
    wanted = [(parameter, kind) for parameter, kind in wanted if parameter.name not in given]
    named = next((p.name for p, _ in wanted if p.name == "atom"), next((p.name for p, _ in wanted), ""))
    for parameter, kind in wanted:
        if dataclass := dataclass_of(kind):
            properties |= fields_schema(dataclass)
            needed = [f.name for f in fields(dataclass) if f.default is MISSING]
            required += [] if has_presets(dataclass) else needed
            continue
        properties[parameter.name] = value_schema(
            parameter.name, kind, parameter.default, said.get(parameter.name)
        )
        stands = parameter.name == named and (kind is str or is_list(kind))  # for the entry's name
        optional = type(None) in alternatives(kind)
        if parameter.default is inspect.Parameter.empty and not stands and not optional:
            required.append(parameter.name)
    schema: Schema = {"properties": properties, "additionalProperties": False}
    return {**schema, "required": required} if required else schema


def has_presets(kind: type) -> bool:
    """Return whether a preset may say what a file leaves out."""
    return bool(getattr(kind, "PRESETS", None))


def fields_schema(kind: type) -> Schema:
    """Return the keys that the fields of a dataclass are."""
    hints, said = get_type_hints(kind), documented(kind)
    defaults: Mapping[str, Any] = {
        field.name: inspect.Parameter.empty if field.default is MISSING else field.default
        for field in fields(kind)
    }
    return {
        name: value_schema(name, hints[name], default, said.get(name)) for name, default in defaults.items()
    }


def value_schema(key: str, kind: Any, default: Any, description: str | None = None) -> Schema:
    """Return what one key may be."""
    top: Schema = {}
    with suppress(ConfigError):  # what stands for a value need not make an object; it was asked for before
        read_value(asked_for_all(top), key, kind, default)
    found: Schema = top["properties"][key]
    found.pop("default", None)
    if default is not None and default is not inspect.Parameter.empty and default != ():
        found["default"] = default
    for part in get_args(kind):
        if inspect.isclass(part) and is_dataclass(part):  # the entries of a mapping
            needed = [field.name for field in fields(part) if field.default is MISSING]
            found["additionalProperties"] |= {"properties": fields_schema(part), "required": needed}
    return found if description is None else {"description": description, **found}
