"""The schemas for editors: they take what our readers take, and refuse what is refused for its structure."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema_rs
import pytest
import yaml
from click.testing import CliRunner
from jsonschema_rs import Draft202012Validator
from tests.blocks import BLOCKS, ROOT, Block
from tests.clients import test_agent_config
from tests.model import test_component_yaml, test_functions

from robomend.cli.commands import cli
from robomend.cli.robot_file import plain
from robomend.cli.schema import FILES, schema_line, schema_name, schema_of, schema_text, shown
from robomend.model import component_yaml
from robomend.model.json_schema import component_schema
from robomend_client.observers.schema import kind_schema
from robomend_client.yaml_tree import read_tree

EXAMPLES = ROOT / "examples"


@cache  # not while tests are collected: every worker would make them all
def validator(file: str) -> Draft202012Validator:
    return Draft202012Validator(schema_of(file))


def complaint(file: str, text: str) -> str:
    """Return what a schema finds wrong with a text, as an editor would read it (YAML 1.2); empty: nothing."""
    error = next(iter(validator(file).iter_errors(plain(read_tree(text)))), None)
    return "" if error is None else str(error.message)


@pytest.mark.parametrize("file", FILES)
def test_a_schema_is_a_schema_and_the_one_beside_the_examples_is_this(file: str) -> None:
    jsonschema_rs.meta.validate(schema_of(file))
    assert (EXAMPLES / schema_name(file)).read_text() == schema_text(file), "run ./dev check --fix"


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.yaml")), ids=lambda path: path.name)
def test_an_example_says_which_schema_it_has_and_has_it(path: Path) -> None:
    text = path.read_text()
    file = next(file for file in FILES if text.startswith(schema_line(file)))
    assert complaint(file, text) == ""


MANUAL = [block for block in BLOCKS if block.kind == "yaml" and not block.reason]


@pytest.mark.parametrize("block", [b for b in MANUAL if b.use == "agent"], ids=str)
def test_the_agents_files_of_the_manual_have_their_schema(block: Block) -> None:
    whole = "" if "robot:" in block.text else 'robot: r\nservice: {url: "http://127.0.0.1:1"}\n'
    assert complaint("agent", whole + block.text) == ""


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("model", test_component_yaml.FULL),
        ("model", test_functions.ROBOT),
        ("model", "robomend: 1\nnodes: [a, b]\nhardware:\n"),
        ("model", "robomend: 1\nnodes:\n  a:\n  on: {drives: off, publishes: [t]}\nhardware: {off: {}}\n"),
        ("model", "ab: AB\nnab: NAB\nneg_prefix: not_\nprops: [p]\nrules: ['NAB(x),p->q']\n"),
        ("agent", test_agent_config.WHOLE),
        ("agent", "robot: r\nservice: {url: 'http://h'}\ntopics: {scan: }\nbus: {join: 'tcp:h:1'}\n"),
        ("agent", "robot: r\nservice: {url: 'http://h'}\nobservers: {a: {kind: a.py:A, any: [1]}}\n"),
        ("observers", "observers: {a: {kind: general, preset: published}}\nrobot: r\n"),
        ("observers", "a: {kind: property, source: s, preset: published}\n"),
        ("robot", "model: m\nwindows: [{start: '22:00', end: '05:30'}]\nperiod_s: 1\n"),
    ],
)
def test_what_the_readers_take_is_taken(file: str, text: str) -> None:
    assert complaint(file, text) == ""


AGENT = "robot: r\nservice: {url: 'http://h'}\n"


@pytest.mark.parametrize(
    ("file", "text", "old", "new"),
    [
        ("model", test_component_yaml.FULL, old, new)
        for old, new in (
            ("name: full", "nmae: full"),
            ("robomend: 1", "robomend: 2"),
            ("channel: 11", "channel: x"),
            ("channel: 11", "channel: -1"),
            ("channel: 11", "channel: 11, start_s: 3"),
            ("prior: 0.1,", "prior: 1,"),
            ("cost: 3", "cost: 0"),
            ("host: pc2", "host: [pc2]"),
            ("topic: cmd, field: z", "topic: cmd"),
            ("[[yaw, turn]]", "[[yaw]]"),
            ("stuck: [", "unknown: ["),
            ("exhaustive_modes: true", "exhaustive_modes: maybe"),
            ("clock: {}", "'': {}"),
        )
    ]
    + [
        ("agent", test_agent_config.WHOLE, old, new)
        for old, new in (
            ("robot: tedusar", "robbot: tedusar"),
            ("robot: tedusar", "robot:"),
            ("http://", "ftp://"),
            ("tcp:127.0.0.1:0", "127.0.0.1"),
            ("lifetime_s: 5", "lifetime_s: soon"),
            ("when_agent_ends: keep", "when_agent_ends: pray"),
            ("window: 11", "window: 2.5"),
            ("rate_hz: 20", "hz: 20"),
            ("[laser, --device, /dev/ttyACM0]", "[]"),
        )
    ]
    + [
        ("agent", f"{AGENT}observers:\n  x: {right}\n", right, wrong)
        for right, wrong in (
            ("{kind: general}", "{kind: genral}"),
            ("{kind: general}", "{kind: general, rate_hz: fast}"),
            ("{kind: qualitative, source: a}", "{kind: qualitative}"),
            ("{kind: diagnostic, status: [a]}", "{kind: diagnostic, status: a}"),
            ("{kind: general, preset: published}", "{kind: general, preset: publshed}"),
        )
    ]
    + [
        ("agent", f"{AGENT}actions:\n  x: {right}\n", right, wrong)
        for right, wrong in (
            ("{kind: process, command: [a]}", "{kind: proces, command: [a]}"),
            ("{kind: process, command: [a]}", "{kind: process, command: [a], shell: true}"),
            ("{kind: process, command: [a]}", "{kind: process}"),
        )
    ]
    + [
        ("robot", "model: m\npolicy: auto\n", old, new)
        for old, new in (
            ("model", "modle"),
            ("auto", "ask"),
            ("policy: auto", "limits: {rounds: 0}"),
            ("model: m\n", ""),
        )
    ],
)
def test_what_the_readers_refuse_for_its_structure_is_refused(
    file: str, text: str, old: str, new: str
) -> None:
    assert complaint(file, text) == ""
    wrong = text.replace(old, new, 1)
    assert wrong != text
    assert complaint(file, wrong)


def test_the_schema_of_a_model_has_the_readers_keys_no_more_and_no_fewer() -> None:
    sections = component_schema()["properties"]
    assert tuple(sections) == component_yaml.MODEL_KEYS
    for section, known in {
        "hardware": component_yaml.HARDWARE_KEYS,
        "nodes": component_yaml.NODE_KEYS,
        "topics": component_yaml.TOPIC_KEYS,
        "properties": component_yaml.PROPERTY_KEYS,
        "values": component_yaml.VALUE_KEYS,
        "remedies": component_yaml.REMEDY_KEYS,
        "functions": component_yaml.FUNCTION_KEYS,
    }.items():
        assert tuple(sections[section]["additionalProperties"]["properties"]) == known
    variants = sections["functions"]["additionalProperties"]["properties"]["variants"]
    assert tuple(variants["additionalProperties"]["properties"]) == component_yaml.VARIANT_KEYS


def keys_of(schema: dict[str, Any], place: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield each key that a file may have, by its place, with its schema."""
    for keyword, value in schema.items():
        if keyword in ("properties", "$defs"):
            for name, one in value.items():
                if keyword == "properties":
                    yield f"{place}.{name}", one
                yield from keys_of(one, f"{place}.{name}")
        elif keyword != "if":  # it only asks which kind an entry is of
            for one in value if isinstance(value, list) else [value]:
                if isinstance(one, dict):
                    yield from keys_of(one, place)


UNITS = {"_s": "second", "_hz": "per second", "_a": "amperes", "mb": "megabytes", "_per_hour": "in an hour"}
"""By how a key ends, how its unit is called."""


@pytest.mark.parametrize("file", FILES)
def test_of_every_key_an_editor_shows_what_it_is_with_unit_and_default(file: str) -> None:
    keys = list(keys_of(json.loads(schema_text(file)), file))
    assert len(keys) > 25
    for place, schema in keys:
        description = schema.get("description", "")
        assert description, place
        for end, unit in UNITS.items():
            assert not place.endswith(end) or unit in description, place
        if (default := schema.get("default")) not in (None, [], {}, ""):
            told = description.rpartition("; default: ")[2]
            assert yaml.safe_load(told) == default, place


def test_what_an_observer_of_others_says_of_its_keys_is_shown_and_one_that_says_nothing_is_too() -> None:
    class Told:
        """Watches."""

        def __init__(self, source: str, limit: float = 3.5, quiet: bool = False) -> None:
            """
            Args:
                source: where its readings come from.
                limit: above it is too hot, in °C;
                    below it is not.
            """

    keys = shown(kind_schema(Told))["properties"]
    assert keys["limit"]["description"] == "above it is too hot, in °C; below it is not; default: 3.5"
    assert keys["quiet"]["description"] == "default: false"


@pytest.mark.parametrize("file", FILES)
def test_the_command_writes_it(file: str) -> None:
    done = CliRunner().invoke(cli, ["schema", file])
    assert json.loads(done.output)["title"].startswith("robomend: ")
