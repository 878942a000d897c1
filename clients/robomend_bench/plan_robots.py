"""Seeded random robots and states for the planning benchmark and its tests.

`random_robot` is any robot, `supplied_robot` one whose power supply makes most of it a single question.

A robot of n components has about a quarter devices, half of them fed by another, most on a channel of a
power board large enough; half of the devices have a driver; the other nodes rest on the topics of up to
three earlier nodes, near ones preferred, so that the longest chain grows with n. Now and then a node is
tied to another, is not restartable, or closes a cycle of topics. Same seed, same robot, on every machine.
"""

from __future__ import annotations

import random
from collections.abc import Collection
from dataclasses import replace

from robomend.model.components import ComponentModel, Hardware, Node
from robomend.planning.problem import needs_of
from robomend_client.literals import Literal, fails


def random_robot(seed: int, components: int, *, awkward: bool = True) -> ComponentModel:
    """Return a robot of `components` components; not awkward: everything can be switched and restarted."""
    chance = random.Random(f"robot {seed} {components}")
    devices = max(1, components // 4)
    hardware: dict[str, Hardware] = {}
    for index in range(devices):
        name = f"device{index}"
        feeders = (f"device{chance.randrange(index)}",) if index and chance.random() < 0.5 else ()
        channel = None if awkward and chance.random() < 0.15 else index
        hardware[name] = Hardware(name, channel, fed_by=feeders)
    nodes: dict[str, Node] = {}
    names = [f"node{index}" for index in range(components - devices)]
    for index, name in enumerate(names):
        topic = f"topic{index}"
        if index < devices and chance.random() < 0.7:
            nodes[name] = Node(name, drives=(f"device{index}",), publishes={topic: ()})
            continue
        near = names[max(0, index - 12) : index]
        inputs = chance.sample(near, min(len(near), chance.randint(1, 3)))
        rests_on = tuple(f"topic{names.index(other)}" for other in inputs)
        tied = (chance.choice(near),) if near and chance.random() < 0.05 else ()
        node = Node(name, publishes={topic: rests_on}, tied_to=tied)
        if awkward and chance.random() < 0.03:
            node = replace(node, restartable=False)
        nodes[name] = node
    if awkward and len(names) > 4 and chance.random() < 0.3:
        # Close a cycle of topics between the last node and one before it.
        first = nodes[names[-3]]
        nodes[first.name] = replace(
            first, publishes={topic: (*on, f"topic{len(names) - 1}") for topic, on in first.publishes.items()}
        )
    return ComponentModel(f"random-{seed}", hardware, nodes, {}, channels=devices)


def supplied_robot(seed: int) -> ComponentModel:
    """Return a robot of 9 to 14 components: one supply feeds 4 to 6 devices, each with its driver.

    Three devices or more hang on the supply itself, others now and then on a device before them; a driver may
    be tied to the one before it, and most robots have a node that rests on two drivers. Whatever cycles the
    supply takes all of that along: one part of 18 to 26 actions.
    """
    chance = random.Random(f"supplied {seed}")
    count = chance.choice((4, 5, 6))
    hardware = {"supply": Hardware("supply", 0)}
    nodes: dict[str, Node] = {}
    for index in range(count):
        device, driver = f"device{index}", f"driver{index}"
        chained = index >= 3 and chance.random() < 0.4
        feeder = f"device{chance.randrange(index)}" if chained else "supply"
        hardware[device] = Hardware(device, index + 1, fed_by=(feeder,))
        tied = (f"driver{index - 1}",) if index and chance.random() < 0.25 else ()
        nodes[driver] = Node(driver, drives=(device,), publishes={f"topic{index}": ()}, tied_to=tied)
    if chance.random() < 0.6:
        nodes["merger"] = Node("merger", publishes={"merged": ("topic0", "topic1")})
    return ComponentModel(f"supplied-{seed}", hardware, nodes, {}, channels=count + 1)


def broken(model: ComponentModel, bad: Collection[str], seed: int | None = None) -> list[Literal]:
    """Return OBS in which bad components are off or stopped; with a seed only half of them are."""
    chance = random.Random(f"state {seed}")
    seen: list[Literal] = []
    for name in model.components:
        if name not in bad or (seed is not None and chance.random() < 0.5):
            continue
        if name in model.nodes:
            seen.append(fails("running", name))
        elif model.switchable(name):
            seen.append(fails("on", name))
    return seen


def some_bad(model: ComponentModel, count: int, seed: int) -> tuple[str, ...]:
    """Return `count` components, one a driver or a device where there is one."""
    return tuple(random.Random(f"bad {seed}").sample(model.components, min(count, len(model.components))))


def longest_chain(model: ComponentModel) -> int:
    """Return how many nodes the longest chain of `needs` has."""
    follows: dict[str, list[str]] = {name: [] for name in model.nodes}
    for node, other in needs_of(model):
        follows[node].append(other)
    depth: dict[str, int] = {}
    for name in model.nodes:
        work = [name]
        while work:
            top = work[-1]
            missing = [other for other in follows[top] if other not in depth]
            if missing:
                work.extend(missing)
                continue
            depth[work.pop()] = 1 + max((depth[other] for other in follows[top]), default=0)
    return max(depth.values(), default=0)
