"""A robot of the bench: what robomend is told of it (the model), and what it is (the anatomy), kept apart.

Hand-made robots are files in robots/, two YAML documents each: the model, word for word as it goes to the
service, and the physics that nobody is told. `made-N` is a generated robot: see generator.py. A robot whose
topics all have one rate is the same one otherwise, so that the same faults can be planted into it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import yaml

from robomend_bench.faults.anatomy import Anatomy, read_anatomy
from robomend_bench.faults.classes import universe_of
from robomend_bench.faults.generator import made
from robomend_bench.faults.observing import SLOWEST_HZ
from robomend_bench.faults.policy import Policy
from robomend_bench.faults.universe import Universe
from robomend_client.literals import Literal

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

    @property
    def slowest_hz(self) -> float:
        """Return a rate that none of its topics is below."""
        return SLOWEST_HZ if self.topics_hz is None else self.topics_hz

    @cached_property
    def universe(self) -> Universe:
        return universe_of(self.anatomy)

    @cached_property
    def policy(self) -> Policy:
        return Policy(self.anatomy)

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


def robot_names() -> tuple[str, ...]:
    """Return the robots that run by default."""
    return (*sorted(path.stem for path in FOLDER.glob("*.yaml")), *MADE)


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
    path = FOLDER / f"{name}.yaml"
    if not name.isidentifier() or not path.exists():
        raise KeyError(name)
    text, _, _ = path.read_text(encoding="utf-8").partition("\n---\n")
    model, rest = yaml.safe_load_all(path.read_text(encoding="utf-8"))
    return Robot(name, text + "\n", read_anatomy(model, rest.get("physics", {})), rest.get("robot", {}))


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
