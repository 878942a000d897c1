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
from tests.clients import test_agent_config, test_agent_executors
from tests.clients.observers import test_kinds
from tests.model import test_component_yaml, test_functions

from robomend.cli.commands import cli
from robomend.cli.robot_file import plain
from robomend.cli.schema import FILES, schema_line, schema_name, schema_of, schema_text, shown
from robomend.model import component_yaml
from robomend.model.json_schema import component_schema
from robomend_client.observers.schema import kind_schema
from robomend_client.yaml_tree import YamlError, read_tree

EXAMPLES = ROOT / "examples"


@cache  # not while tests are collected: every worker would make them all
def validator(file: str) -> Draft202012Validator:
    return Draft202012Validator(schema_of(file))


def complaint(file: str, text: str, folder: Path) -> str:
    """Return what a schema finds wrong with a text, as an editor would read it (YAML 1.2); empty: nothing."""
    error = next(iter(validator(file).iter_errors(plain(read_tree(text)))), None)
    return "" if error is None else str(error.message)


def rows(test: Any) -> list[tuple[Any, ...]]:
    """Return the rows that a test of a reader is run with."""
    found: list[tuple[Any, ...]] = test.pytestmark[0].args[1]
    return found


@pytest.mark.parametrize("file", FILES)
def test_a_schema_is_a_schema_and_the_one_beside_the_examples_is_this(file: str) -> None:
    jsonschema_rs.meta.validate(schema_of(file))
    assert (EXAMPLES / schema_name(file)).read_text() == schema_text(file), "run ./dev check --fix"


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.yaml")), ids=lambda path: path.name)
def test_an_example_says_which_schema_it_has_and_has_it(path: Path, tmp_path: Path) -> None:
    text = path.read_text()
    file = next(file for file in FILES if text.startswith(schema_line(file)))
    assert complaint(file, text, tmp_path) == ""


MANUAL = [block for block in BLOCKS if block.kind == "yaml" and not block.reason]


@pytest.mark.parametrize("block", [b for b in MANUAL if b.use == "agent"], ids=str)
def test_the_agents_files_of_the_manual_have_their_schema(block: Block, tmp_path: Path) -> None:
    whole = "" if "robot:" in block.text else 'robot: r\nservice: {url: "http://127.0.0.1:1"}\n'
    assert complaint("agent", whole + block.text, tmp_path) == ""


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
def test_what_the_readers_take_is_taken(file: str, text: str, tmp_path: Path) -> None:
    assert complaint(file, text, tmp_path) == ""


BEYOND_MODEL = {
    "channel: 12": "how many channels there are stands elsewhere in the text",
    "channel: 0": "two entries have one channel",
    "psu: {fed_by: [base]}": "a circle",
    "psu: {fed_by: psu}": "a circle",
    "[pssu]": "what a name refers to",
    "[base, imv]": "what a name refers to",
    "": "keys that go together, by what a name refers to",
    "cmd: [odm]": "what a name refers to",
    "tied_to: [diver]": "what a name refers to",
    "tied_to: [planner]": "an entry that refers to itself",
    "base:": "a name in two sections",
    "driver:": "names are compared without their leading slash",
    "odom: {}": "a name in two sections",
    "topic: cmds,": "what a name refers to",
    "values:\n  {yaw: {topic: oddom, field: c}, twist:\n ": "no YAML",
    "\n  turn: {topic: cmds,": "what a name refers to",
    "temp: {cost: 4},\n  odom: {}": "a name in two sections",
    "[[yaw, tern]]": "what a name refers to",
    "ab(planer)": "a sentence",
    "not ok(temp -> ": "a sentence",
    "not on(temp)": "a sentence",
    "channels: 12\nchannels: 12": "a key twice: the YAML parser of an editor says so",
}
"""What a reader refuses and a schema cannot, by what was put into the text, and why."""


@pytest.mark.parametrize(
    ("old", "new"),
    [row[:2] for row in rows(test_component_yaml.test_mistakes_are_named_with_line_and_remedy)],
)
def test_a_model_that_is_refused_for_its_structure_is_refused_by_the_schema(
    old: str, new: str, tmp_path: Path
) -> None:
    text = test_component_yaml.FULL.replace(old, new, 1)
    try:
        found = complaint("model", text, tmp_path)
    except YamlError:  # no YAML
        found = ""
    assert (found == "") == (new in BEYOND_MODEL)


BEYOND_AGENT = {
    "agent: pc": "a key twice: the YAML parser of an editor says so",
    "http://127.0.0.1:x": "the grammar of URLs",
    "https://[::1": "the grammar of URLs",
    "key_file: agent.yaml": "what is in a file",
    "key_file: none": "whether there is a file",
    'state_dir: "a\\0b"': "a NUL, which is an escape in YAML",
    "lifetime_s: 1.5": "one number against another",
    "settle: 11": "one number against another",
    "rate_hz: 1": "one number against another",
    "(": "a regular expression",
    "topics: [": "no YAML",
    "  # é🤖\n  odom\a:": "no YAML",
}
BEYOND_OBSERVERS = {
    "{kind: general, rate_hz: 0}": "a bound that the observer itself has",
    "{kind: property, source: a}": "one of two keys is needed, says the observer itself",
    "{kind: property, source: a, high: 1, filter: mode}": "a choice that the observer itself has",
    "{kind: diagnostic, status: [a], rules: [hot]}": "a sentence",
    "{kind: multiple, in_topic: a, out_topic: a}": "one key against another",
    "{kind: property, atom: 'ok((', source: a, high: 1}": "a sentence",
    "{kind: goals, in_a_row: 0}": "a bound that the observer itself has",
    "{kind: rosout, level: info}": "a choice that the observer itself has",
    "{kind: rosout, ignore: ['*']}": "a sentence",
    "{kind: lifecycle, state: running}": "a choice that the observer itself has",
    "{kind: changing, source: a, still_s: 0}": "a bound that the observer itself has",
    "{kind: publishers, least: 2}": "one key against another",
    "{kind: nowhere.py:A}": "whether there is a file",
    "{kind: bad.py:A}": "what is in a file",
    "{kind: good.py:B}": "what is in a file",
    "{kind: good.py:Untyped}": "what is in a file",
    "{kind: good.py:Odd, limit: 1}": "what is in a file",
}
BEYOND_ACTIONS = {
    "{kind: systemd, units: {a: -H}, verb: start}": "the grammar of units",
    "{kind: systemd, units: {a: a.service}}": "a key that the executor itself needs",
    "{kind: horn.py:Horn}": "what is in a file",
    "{kind: reset_usb, devices: {a: camera}}": "the grammar of devices",
}


@pytest.mark.parametrize(
    ("old", "new"), [row[:2] for row in rows(test_agent_config.test_each_mistake_is_named_with_its_place)]
)
def test_an_agents_file_that_is_refused_for_its_structure_is_refused_by_the_schema(
    old: str, new: str, tmp_path: Path
) -> None:
    try:
        found = complaint("agent", test_agent_config.WHOLE.replace(old, new, 1), tmp_path)
    except YamlError:  # no YAML
        found = ""
    assert (found == "") == (new in BEYOND_AGENT)


@pytest.mark.parametrize(
    ("section", "entry", "beyond"),
    [
        *(
            ("observers", row[0], BEYOND_OBSERVERS)
            for row in rows(test_kinds.test_each_mistake_is_named_with_its_place)
        ),
        *(
            ("actions", row[0], BEYOND_ACTIONS)
            for row in rows(test_agent_executors.test_each_mistake_is_named_with_its_place)
        ),
    ],
)
def test_an_observer_or_action_that_is_refused_for_its_structure_is_refused_by_the_schema(
    section: str, entry: str, beyond: dict[str, str], tmp_path: Path
) -> None:
    text = f'robot: r\nservice: {{url: "http://127.0.0.1:1"}}\n{section}:\n  x: {entry}\n'
    assert (complaint("agent", text, tmp_path) == "") == (entry in beyond)
    if section == "observers":
        assert (complaint("observers", text, tmp_path) == "") == (entry in beyond)


@pytest.mark.parametrize(
    "text", ["model: m\npolicy: ask\n", "modle: m\n", "model: m\nlimits: {rounds: 0}\n", "policy: auto\n"]
)
def test_a_robots_configuration_is_held_to_what_http_takes(text: str, tmp_path: Path) -> None:
    assert complaint("robot", text, tmp_path)


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
