"""Random robots, the same for the same number: models and physics of 8 to 24 components.

About a third is hardware on channels, some of it fed by a supply; each device has a driver; the other nodes
rest on one to three topics that came shortly before them. Now and then two nodes are tied, a topic is not
watched, or a loop is closed by a node that kicks. Results are compared across versions: do not change this
generator, give the next one another prefix.
"""

from __future__ import annotations

import random
from typing import Any

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
