"""A robot as it was described, and the three files that say so: model, agent's file, configuration.

They fit together because they come from one description, and are read by our own readers before anybody
sees them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robomend.cli.schema import schema_line
from robomend.errors import InputError, ModelError
from robomend.model.components import ComponentModel
from robomend.model.loading import load_text
from robomend_client.literals import PLAIN_NAME, holds

DEFAULT_RATE_HZ = 10.0
URL = "http://127.0.0.1:8600"
NO_TEXT = frozenset({"null", "true", "false", "yes", "no", "on", "off"})


@dataclass
class Described:
    """What was said of a robot."""

    robot: str
    devices: dict[str, int | None] = field(default_factory=dict)  # with their channels
    nodes: dict[str, tuple[str, ...]] = field(default_factory=dict)  # with the topics that they publish
    rests_on: dict[str, tuple[str, ...]] = field(default_factory=dict)  # topic -> topics
    drives: dict[str, tuple[str, ...]] = field(default_factory=dict)  # node -> devices
    commands: dict[str, tuple[str, ...]] = field(default_factory=dict)  # node -> program and arguments
    rates_hz: dict[str, float] = field(default_factory=dict)  # topic -> rate
    board: tuple[str, int] | None = None  # host, port
    url: str = URL
    origin: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # ros1 or ros2, with its keys
    model_text: str | None = None  # where something else proposed it


def files_of(described: Described) -> dict[str, str]:
    """Return the files of a robot by their names, checked by whoever reads them.

    Raises:
        InputError: what was said does not fit together, with the words of the reader.
    """
    name = f"{described.robot}.yaml"
    model = described.model_text or model_text(described)
    model = schema_line("model") + model
    try:
        system = load_text(model, name=described.robot, file=name)
    except ModelError as error:
        raise InputError(str(error)) from error
    parts = system.parts
    assert parts is not None  # a component model has them
    texts = {
        name: model,
        "agent.yaml": schema_line("agent") + agent_text(described, parts),
        "robot.yaml": schema_line("robot") + robot_text(described, parts),
    }
    check_agent(texts["agent.yaml"])
    check_robot(texts["robot.yaml"])
    return texts


def model_text(described: Described) -> str:
    """Return the component model."""
    return "\n".join(_model_lines(described)) + "\n"


def _model_lines(said: Described) -> Iterator[str]:
    yield f"# What {said.robot} is made of: docs/models.md. `robomend model check` says what is left out."
    yield "robomend: 1"
    yield f"name: {_word(said.robot)}"
    if said.devices:
        yield "hardware:"
        for device, channel in said.devices.items():
            # Without a channel, a device is blamed beside its driver only where this is said.
            wired = f"channel: {channel}" if channel is not None else "blame_hardware: true"
            yield f"  {_word(device)}: {{{wired}}}"
    yield "nodes:"
    for node, topics in said.nodes.items():
        keys = []
        if driven := said.drives.get(node):
            keys.append(f"drives: {_words(driven)}")
            if any(said.rests_on.get(topic) for topic in topics):
                keys.append("inputs_matter: true")
        if topics:
            published = ", ".join(f"{_word(t)}: {_words(said.rests_on.get(t, ()))}" for t in topics)
            keys.append(f"publishes: {{{published}}}")
        yield f"  {_word(node)}: {{{', '.join(keys)}}}"
    every = [topic for topics in said.nodes.values() for topic in topics]
    if every:
        yield "topics:                       # messages per second, and how far that may stray"
        for topic in every:
            rate = said.rates_hz.get(topic, DEFAULT_RATE_HZ)
            yield f"  {_word(topic)}: {{rate_hz: {rate:g}, tolerance_hz: {rate / 5:g}}}"


def agent_text(said: Described, parts: ComponentModel) -> str:
    """Return the agent's file: what it watches, and the programs that it supervises."""
    lines = [
        "# The robot's side: robomend-agent agent.yaml (--check: what it means). Every key: docs/agent.md.",
        f"robot: {said.robot}",
        f"service: {{url: {json.dumps(said.url)}, key_env: ROBOMEND_KEY}}",
    ]
    for origin, keys in said.origin.items():
        lines += [f"{origin}: {json.dumps(keys)}", f"rate: {{from: {origin}}}"]
    if topics := published(parts):
        lines.append(
            "topics:                       # reported as ok(topic), or not, by the rate of the messages"
        )
        for topic in topics:
            known = parts.topics.get(topic)
            rate = (known.rate_hz if known else None) or DEFAULT_RATE_HZ
            tolerance = (known.tolerance_hz if known else None) or rate / 5
            lines.append(f"  {_word(topic)}: {{rate_hz: {rate:g}, tolerance_hz: {tolerance:g}}}")
    if said.commands:
        lines.append("processes:                    # what may be started and stopped; nothing else is")
        for node, command in said.commands.items():
            words = json.dumps(list(command), ensure_ascii=False)
            lines.append(f"  {_word(node)}: {{command: {words}, start: true}}")
    else:
        lines += [
            "# processes:                  # what the agent may start and stop, by the model's names",
            f"#   {_word(next(iter(parts.nodes)))}: {{command: [python3, my_node.py], start: true}}",
        ]
    return "\n".join(lines) + "\n"


def robot_text(said: Described, parts: ComponentModel) -> str:
    """Return the robot's configuration: what it follows, and what the service should hear of."""
    lines = [
        f"# For robomend robot put {said.robot} robot.yaml --model {said.robot}.yaml; fields: docs/http.md.",
        f"model: {said.robot}",
        "policy: approve               # observe: never act; approve: a person says yes; auto",
    ]
    observed = [str(holds("ok", topic)) for topic in published(parts)]
    observed += [str(holds("running", node)) for node in said.commands]
    if observed:
        lines.append("observed:                     # what it should hear of: silence is not health")
        lines += [f"  - {json.dumps(sentence, ensure_ascii=False)}" for sentence in observed]
    if said.board is not None:
        host, port = said.board
        lines.append(f"board: {{host: {json.dumps(host)}, port: {port}, protected: [2]}}   # never shut down")
    elif any(device.channel is not None for device in parts.hardware.values()):
        lines.append(
            "# board: {host: 127.0.0.1, port: 10001}    # without it nothing switches the devices' channels"
        )
    return "\n".join(lines) + "\n"


def published(parts: ComponentModel) -> list[str]:
    """Return the topics that the nodes of a model publish, each once."""
    return list(dict.fromkeys(topic for node in parts.nodes.values() for topic in node.publishes))


def check_agent(text: str) -> None:
    """Read an agent's file as the agent does."""
    from robomend_client.agent.config import read_config
    from robomend_client.yaml_reader import ConfigError, Section
    from robomend_client.yaml_tree import read_tree

    try:
        read_config(Section(read_tree(text), "agent.yaml", ""), Path())
    except ConfigError as error:
        raise InputError(str(error)) from error


def check_robot(text: str) -> None:
    """Read a robot's configuration as the service does."""
    from pydantic import ValidationError

    from robomend.api.schemas.robots import RobotBody
    from robomend.cli.robot_file import read_robot_text

    try:
        RobotBody.model_validate(read_robot_text(text, "robot.yaml"))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise InputError(f"robot.yaml: {place}: {first['msg']}") from error


def _word(name: str) -> str:
    """Return a name as YAML has it; what editors take for no text is in quotes."""
    plain = name[:1].isalpha() and PLAIN_NAME.match(name) and name.lower() not in NO_TEXT
    return name if plain else json.dumps(name, ensure_ascii=False)


def _words(names: tuple[str, ...]) -> str:
    return f"[{', '.join(map(_word, names))}]"
