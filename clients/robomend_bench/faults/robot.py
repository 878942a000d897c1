"""A robot of the bench: what robomend is told of it (the model), and what it is (the anatomy), kept apart.

Hand-made robots are files in robots/, two YAML documents each: the model, word for word as it goes to the
service, and the physics that nobody is told. `made-N` is a generated robot (below). A robot whose
topics all have one rate is the same one otherwise, so that the same faults can be planted into it.
"""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import yaml

from robomend_bench.faults.anatomy import Anatomy, Aspect, read_anatomy
from robomend_bench.faults.classes import CLASSES, Scenario, universe_of
from robomend_bench.faults.field import WORLDS
from robomend_bench.faults.observing import SLOWEST_HZ
from robomend_bench.faults.policy import Policy
from robomend_bench.faults.universe import Universe
from robomend_client.literals import Literal, parse_atom

# --- random robots, the same for the same number: models and physics of 8 to 24 components.
#
# About a third is hardware on channels, some of it fed by a supply; each device has a driver; the other
# nodes rest on one to three topics that came shortly before them. Now and then two nodes are tied, a topic
# is not watched, or a loop is closed by a node that kicks. Results are compared across versions: do not
# change this generator, give the next one another prefix.

REACH = 5
"""A node rests on some of so many topics before its own."""


def made(number: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the model and the physics of a robot, as their YAML documents."""
    chance = random.Random(f"faults robot {number}")
    devices, others = chance.randint(2, 6), chance.randint(4, 12)
    hardware: dict[str, Any] = {}
    nodes: dict[str, Any] = {}
    topics: dict[str, Any] = {}
    physics: dict[str, Any] = {"devices": {}, "nodes": {}, "unobserved": []}
    supply = chance.random() < 0.5
    if supply:
        hardware["supply"] = {"channel": 0}

    def publish(node: str, inputs: list[str]) -> dict[str, list[str]]:
        names = [f"{node}_out{index}" for index in range(1 + (chance.random() < 0.25))]
        rate = chance.choice((5, 10, 10, 10, 20))
        topics.update({name: {"rate_hz": rate, "tolerance_hz": rate / 5} for name in names})
        return {name: list(inputs) for name in names}

    for index in range(devices):
        device, driver = f"device{index}", f"driver{index}"
        hardware[device] = {"channel": index + (1 if index < 1 else 2)}  # not 2, by custom the computer's
        if supply and chance.random() < 0.5:
            hardware[device]["fed_by"] = ["supply"]
        nodes[driver] = {"drives": [device], "publishes": publish(driver, [])}
        physics["devices"][device] = {"boot_s": round(chance.uniform(0.2, 1.5), 2)}
    for index in range(others):
        node = f"node{index}"
        near = list(topics)[-REACH:]
        inputs = chance.sample(near, min(len(near), chance.randint(1, 3)))
        nodes[node] = {"publishes": publish(node, inputs)}
        if index and chance.random() < 0.1:
            nodes[node]["tied_to"] = [f"node{index - 1}"]
        physics["nodes"][node] = {"warm_s": round(chance.uniform(0.1, 1.2), 2)}
    if chance.random() < 0.4:
        _close_a_loop(nodes, physics, chance)
    elif chance.random() < 0.5:
        physics["unobserved"].append(chance.choice(list(nodes["driver0"]["publishes"])))
    return (
        {
            "robomend": 1,
            "name": f"made-{number}",
            **({"hardware": hardware} if hardware else {}),
            "nodes": nodes,
            "topics": topics,
        },
        physics,
    )


def _close_a_loop(nodes: dict[str, Any], physics: dict[str, Any], chance: random.Random) -> None:
    """Let a node need what one that needs it publishes."""
    pairs = [
        (first, second)
        for first in nodes
        for second in nodes
        if "drives" not in nodes[first]
        and set(nodes[first]["publishes"]) & {i for on in nodes[second]["publishes"].values() for i in on}
    ]
    if pairs:
        first, second = chance.choice(pairs)
        back = next(iter(nodes[second]["publishes"]))
        nodes[first]["publishes"] = {topic: [*on, back] for topic, on in nodes[first]["publishes"].items()}
        physics["nodes"][first]["kicks"] = True


FOLDER = Path(__file__).parent / "robots"

MADE = ("made-1", "made-2", "made-3", "made-4")
"""The generated robots that run by default; any other number can be named as well."""

SLOW: Mapping[str, Any] = {"timeout_s": 20, "effect_timeout_s": 30}
"""What a robot says of `start_node` whose nodes are slow."""


@dataclass(frozen=True)
class Robot:
    """See the module."""

    name: str
    model: str  # the text that the service gets
    anatomy: Anatomy
    config: Mapping[str, Any] = field(default_factory=dict)  # of the robot's resource, besides the usual
    topics_hz: float | None = None  # the rate that all of its topics have; None: each its own
    world: str = "usual"  # whose faults it may have

    @property
    def slowest_hz(self) -> float:
        """Return a rate that none of its topics is below."""
        return SLOWEST_HZ if self.topics_hz is None else self.topics_hz

    @cached_property
    def universe(self) -> Universe:
        return universe_of(self.anatomy, dict.fromkeys((*CLASSES, *WORLDS[self.world])))

    @cached_property
    def policy(self) -> Policy:
        """The cheapest repairs by who knows which drivers reconnect by themselves."""
        return Policy(self.anatomy)

    @cached_property
    def told_policy(self) -> Policy:
        """The same by who knows of drivers what the model says."""
        told = yaml.safe_load(self.model)["nodes"] if self.model else {}
        nodes = {
            name: replace(node, reconnects=bool((told.get(name) or {}).get("reconnects")))
            for name, node in self.anatomy.nodes.items()
        }
        return Policy(replace(self.anatomy, nodes=nodes))

    def settings(
        self, board: Mapping[str, Any] | None, observed: list[Literal], *, slow: bool = False
    ) -> dict[str, Any]:
        """Return the robot's resource: all defaults, but that it may act by itself.

        Where nodes are slow to start, it says how long that may take, as its owner would.
        """
        found: dict[str, Any] = {
            "model": self.name,
            "policy": "auto",
            "observed": sorted(map(str, observed)),
            **self.config,
        }
        if slow:
            found["actions"] = {**found.get("actions", {}), "start_node": SLOW}
        if board is not None:
            found["board"] = {**board, "protected": []}
        return found


def robot_names(world: str = "usual") -> tuple[str, ...]:
    """Return the robots that run by default."""
    here = sorted(path.stem for path in FOLDER.glob("*.yaml"))
    more = sorted(path.stem for path in (FOLDER / world).glob("*.yaml"))
    return (*more, *here, *MADE)


@cache
def find_robot(name: str, topics_hz: float | None = None) -> Robot:
    """Return a robot by its name, on request with one rate for all of its topics.

    Raises:
        KeyError: there is none of this name.
    """
    if topics_hz is not None:
        return _at_one_rate(find_robot(name), topics_hz)
    if name.startswith("made-") and name.removeprefix("made-").isdecimal():
        model, physics = made(int(name.removeprefix("made-")))
        return Robot(name, yaml.safe_dump(model, sort_keys=False), read_anatomy(model, physics))
    path = next((p for p in (FOLDER / f"{name}.yaml", FOLDER / "field" / f"{name}.yaml") if p.exists()), None)
    if not name.isidentifier() or path is None:
        raise KeyError(name)
    text, _, _ = path.read_text(encoding="utf-8").partition("\n---\n")
    model, rest = yaml.safe_load_all(path.read_text(encoding="utf-8"))
    return Robot(name, text + "\n", read_anatomy(model, rest.get("physics", {})), rest.get("robot", {}))


def varied(robot: Robot, scenario: Scenario, world: str) -> Robot:
    """Return the robot as a scenario has it, with a model of its own name where the model says more."""
    if not scenario.physics and not scenario.stamped and world == robot.world:
        return robot
    anatomy = robot.anatomy
    devices = {n: replace(d, **scenario.physics.get(n, {})) for n, d in anatomy.devices.items()}
    nodes = {n: replace(d, **scenario.physics.get(n, {})) for n, d in anatomy.nodes.items()}
    anatomy = replace(anatomy, devices=devices, nodes=nodes)
    model = robot.model
    if scenario.times_known:
        model = _with_times(robot.model, anatomy)
    if scenario.stamped:
        anatomy, model = _stamped(anatomy, model, scenario.stamped)
    return replace(robot, model=model, anatomy=anatomy, world=world)


def _stamped(anatomy: Anatomy, model: str, topic: str) -> tuple[Anatomy, str]:
    """Return both with an observer of a topic's stamps, which are whole seconds."""
    values = {**anatomy.topics[topic].values, "sec": "whole seconds"}
    stamps = replace(anatomy.topics[topic], values=values)
    observer = {"kind": "qualitative", "value": "stamp", "source": f"{topic}:sec"}
    aspect = Aspect(
        parse_atom("inc(stamp)"), observer, anatomy.host_of(topic), flows=(topic,), still=(topic,)
    )
    parsed = yaml.safe_load(model)
    parsed.setdefault("values", {})["stamp"] = {"topic": topic, "field": "sec"}
    rule = f"not ab({anatomy.publisher[topic]}) -> inc(stamp)"
    parsed["rules"] = [*parsed.get("rules", ()), rule]
    topics = {**anatomy.topics, topic: stamps}
    found = replace(anatomy, topics=topics, aspects=(*anatomy.aspects, aspect))
    return found, yaml.safe_dump(parsed, sort_keys=False)


def _with_times(model: str, anatomy: Anatomy) -> str:
    """Return the model with what a robot's owner knows: how long devices boot and nodes start, and which
    drivers need no restart with their devices.
    """
    parsed = yaml.safe_load(model)
    for name, device in anatomy.devices.items():
        parsed["hardware"][name] = {**(parsed["hardware"][name] or {}), "boot_s": device.boot_s}
    for name, node in anatomy.nodes.items():
        start_s = node.start_s + node.warm_s
        known = {"start_s": start_s, "reconnects": True} if node.reconnects else {"start_s": start_s}
        parsed["nodes"][name] = {**(parsed["nodes"][name] or {}), **known}
    return yaml.safe_dump(parsed, sort_keys=False)


def _at_one_rate(robot: Robot, topics_hz: float) -> Robot:
    """Return a robot like this one whose topics all have one rate, with as much tolerance for each of it."""
    topics = {
        name: replace(topic, rate_hz=topics_hz, tolerance_hz=topic.tolerance_hz / topic.rate_hz * topics_hz)
        for name, topic in robot.anatomy.topics.items()
    }
    model = yaml.safe_load(robot.model)
    model["topics"] = {
        name: {
            **(model.get("topics", {}).get(name) or {}),
            "rate_hz": t.rate_hz,
            "tolerance_hz": t.tolerance_hz,
        }
        for name, t in topics.items()
    }
    text = yaml.safe_dump(model, sort_keys=False)
    return replace(robot, model=text, anatomy=replace(robot.anatomy, topics=topics), topics_hz=topics_hz)
