"""Random robots of any size, the same for the same seed: `robots-v1`.

A third of the components is hardware, half of that on a power channel. Each device has a driver that
publishes a topic or two; the other nodes rest on one to three topics that came shortly before them, as the
stages of a perception or planning pipeline do, so that faults cascade through several stages.

What is seen follows from 1-4 broken components: a topic is ok when its publisher, the devices that it
drives and all topics that it rests on are. Broken devices may be off, broken nodes may have stopped. Three
topics of ten are not observed.

Results are compared across versions: do not change this generator, write `robots-v2` beside it.
"""

from __future__ import annotations

import random
from dataclasses import dataclass

from robomend.model.cnf import HealthCnf
from robomend.model.compiling import compile_robot
from robomend.model.components import ComponentModel, Hardware, Node, Topic
from robomend_client.literals import Literal, fails, holds

HARDWARE_SHARE = 1 / 3
REACH = 12
"""A node rests on some of so many topics before its own."""

OBSERVED_SHARE = 0.7


@dataclass(frozen=True)
class Robot:
    """A model and its clauses."""

    model: ComponentModel
    cnf: HealthCnf


def make_robot(components: int, seed: int) -> Robot:
    """Return a robot with so many components, at least 3."""
    chance = random.Random(f"robots-v1 {components} {seed}")
    devices = max(1, round(components * HARDWARE_SHARE))
    hardware: dict[str, Hardware] = {}
    nodes: dict[str, Node] = {}
    topics: list[str] = []

    def publish(node: str, inputs: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
        names = [f"{node}/t{index}" for index in range(1 + (chance.random() < 0.2))]
        topics.extend(names)
        return dict.fromkeys(names, inputs)

    for index in range(devices):
        name = f"device{index}"
        hardware[name] = Hardware(name, channel=index if chance.random() < 0.5 else None)
        driver = f"driver{index}"
        if len(nodes) < components - devices:
            nodes[driver] = Node(driver, drives=(name,), publishes=publish(driver, ()))
    for index in range(components - devices - len(nodes)):
        name = f"node{index}"
        reachable = topics[-REACH:]
        inputs = tuple(chance.sample(reachable, min(len(reachable), chance.randint(1, 3))))
        nodes[name] = Node(name, publishes=publish(name, inputs))
    model = ComponentModel(
        name=f"robot{components}",
        hardware=hardware,
        nodes=nodes,
        topics={name: Topic(name) for name in topics},
        channels=max(10, devices),
    )
    return Robot(model, compile_robot(model).cnf)


def observe(robot: Robot, faults: int, chance: random.Random) -> tuple[Literal, ...]:
    """Return what is seen of a robot with so many broken components; 0: of a healthy one."""
    model = robot.model
    switchable = [name for name, device in model.hardware.items() if device.channel is not None]
    blamable = [*switchable, *model.nodes]
    broken = frozenset(chance.sample(blamable, min(faults, len(blamable))))
    seen: list[Literal] = []
    for name, device in model.hardware.items():
        if device.channel is not None:
            off = name in broken and chance.random() < 0.5
            seen.append(fails("on", name) if off else holds("on", name))
    ok: dict[str, bool] = {}
    for name, node in model.nodes.items():
        stopped = name in broken and chance.random() < 0.5
        seen.append(fails("running", name) if stopped else holds("running", name))
        works = name not in broken and broken.isdisjoint(node.drives)
        for topic, inputs in node.publishes.items():
            ok[topic] = works and all(ok[other] for other in inputs)
            if chance.random() < OBSERVED_SHARE:
                seen.append(holds("ok", topic) if ok[topic] else fails("ok", topic))
    return tuple(seen)
