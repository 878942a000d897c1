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
from robomend.model.from_graph import FirstModel, first_model, observers_lines, word
from robomend.model.loading import load_text
from robomend_client.literals import holds
from robomend_client.ros_graph import Heard

DEFAULT_RATE_HZ = 10.0
URL = "http://127.0.0.1:8600"

OBSERVED_S = 5.0
"""A topic whose silence, and so its first good verdict, takes longer is watched, and not waited for."""


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
    policy: str = "approve"
    bus: str | None = None  # where the agent's is; None: in its own folder
    heard: Heard | None = None  # where a robot was listened to, or its graph read


def model_file(robot: str) -> str:
    """Return the name of a robot's model: `robot.yaml` and `agent.yaml` are other files."""
    return f"{robot}-model.yaml" if robot in ("robot", "agent") else f"{robot}.yaml"


def files_of(described: Described, first: FirstModel | None = None) -> dict[str, str]:
    """Return the files of a robot by their names, checked by whoever reads them.

    Args:
        first: what was made of what was heard, if it was made already.

    Raises:
        InputError: what was said does not fit together, with the words of the reader.
    """
    name = model_file(described.robot)
    if first is None and described.heard is not None:
        first = first_model(described.heard, described.robot)
    model = model_text(described) if first is None else first.text
    model = schema_line("model") + model
    try:
        system = load_text(model, name=described.robot, file=name)
    except ModelError as error:
        raise InputError(str(error)) from error
    parts = system.parts
    assert parts is not None  # a component model has them
    texts = {
        name: model,
        "agent.yaml": schema_line("agent") + agent_text(described, parts, first),
        "robot.yaml": schema_line("robot") + robot_text(described, parts, first),
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
    yield f"name: {word(said.robot)}"
    if said.devices:
        yield "hardware:"
        for device, channel in said.devices.items():
            # Without a channel, a device is blamed beside its driver only where this is said.
            wired = f"channel: {channel}" if channel is not None else "blame_hardware: true"
            yield f"  {word(device)}: {{{wired}}}"
    yield "nodes:"
    for node, topics in said.nodes.items():
        keys = []
        if driven := said.drives.get(node):
            keys.append(f"drives: {_words(driven)}")
            if any(said.rests_on.get(topic) for topic in topics):
                keys.append("inputs_matter: true")
        if topics:
            published = ", ".join(f"{word(t)}: {_words(said.rests_on.get(t, ()))}" for t in topics)
            keys.append(f"publishes: {{{published}}}")
        yield f"  {word(node)}: {{{', '.join(keys)}}}"
    every = [topic for topics in said.nodes.values() for topic in topics]
    if every:
        yield "topics:                       # messages per second, and how far that may stray"
        for topic in every:
            rate = said.rates_hz.get(topic, DEFAULT_RATE_HZ)
            yield f"  {word(topic)}: {{rate_hz: {rate:g}, tolerance_hz: {rate / 5:g}}}"


def agent_text(said: Described, parts: ComponentModel, first: FirstModel | None = None) -> str:
    """Return the agent's file: what it watches, and the programs that it supervises.

    Args:
        first: what came of listening, where somebody listened.
    """
    lines = [
        "# The robot's side: robomend-agent agent.yaml (--check: what it means). Every key: docs/agent.md.",
        f"robot: {word(said.robot)}",
        f"service: {{url: {json.dumps(said.url)}, key_env: ROBOMEND_KEY}}",
    ]
    if said.bus is not None:
        lines.append(f"bus: {{listen: {json.dumps(said.bus)}}}")
    for origin, keys in said.origin.items():
        lines += [f"{origin}: {json.dumps(keys)}", f"rate: {{from: {origin}}}"]
    if said.heard is not None and said.heard.seconds and first is not None:
        lines += observers_lines(first.entries)
    elif topics := published(parts):
        lines.append(
            "topics:                       # reported as ok(topic), or not, by the rate of the messages"
        )
        for topic in topics:
            known = parts.topics.get(topic)
            rate = (known.rate_hz if known else None) or DEFAULT_RATE_HZ
            tolerance = (known.tolerance_hz if known else None) or rate / 5
            lines.append(f"  {word(topic)}: {{rate_hz: {rate:g}, tolerance_hz: {tolerance:g}}}")
    if said.commands:
        lines.append("processes:                    # what may be started and stopped; nothing else is")
        for node, command in said.commands.items():
            words = json.dumps(list(command), ensure_ascii=False)
            lines.append(f"  {word(node)}: {{command: {words}, start: true}}")
    else:
        lines += [
            "# processes:                  # what the agent may start and stop, by the model's names",
            f"#   {word(next(iter(parts.nodes)))}: {{command: [python3, my_node.py], start: true}}",
        ]
    if first is not None and first.offered:
        lines += ["# actions:                    # the remedies that the model has", *first.offered]
    return "\n".join(lines) + "\n"


def robot_text(said: Described, parts: ComponentModel, first: FirstModel | None = None) -> str:
    """Return the robot's configuration: what it follows, and what the service should hear of."""
    heard = said.heard is not None and said.heard.seconds > 0
    lines = [
        f"# For robomend robot put {said.robot} robot.yaml --model {model_file(said.robot)}: docs/http.md.",
        f"model: {word(said.robot)}",
        f"policy: {said.policy}               # observe: never act; approve: a person says yes; auto",
    ]
    if heard and first is not None:
        lines.append(
            "debounce_s: 1                 # what follows from a fault comes a moment after it, or before"
        )
        entries = first.entries
        quick = [name for name, keys in entries.topics.items() if float(keys["silence_s"]) <= OBSERVED_S]
        quick += [name for name, keys in entries.observers.items() if keys["kind"] == "diagnostic"]
        observed = [str(holds("ok", name)) for name in quick]
        observed += [str(holds("running", node)) for node in first.nodes if said.origin]
    else:
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


def _words(names: tuple[str, ...]) -> str:
    return f"[{', '.join(map(word, names))}]"
