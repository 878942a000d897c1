"""A robot of the bench: what robomend is told of it (the model), and what it is (the anatomy), kept apart.

Hand-made robots are files in robots/, two YAML documents each: the model, word for word as it goes to the
service, and the physics that nobody is told. `made-N` is a generated robot: see generator.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import yaml

from robomend_bench.faults.anatomy import Anatomy, read_anatomy
from robomend_bench.faults.classes import universe_of
from robomend_bench.faults.generator import made
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
def find_robot(name: str) -> Robot:
    """Return a robot by its name.

    Raises:
        KeyError: there is none of this name.
    """
    if name.startswith("made-") and name.removeprefix("made-").isdecimal():
        model, physics = made(int(name.removeprefix("made-")))
        return Robot(name, yaml.safe_dump(model, sort_keys=False), read_anatomy(model, physics))
    path = FOLDER / f"{name}.yaml"
    if not name.isidentifier() or not path.exists():
        raise KeyError(name)
    text, _, _ = path.read_text(encoding="utf-8").partition("\n---\n")
    model, rest = yaml.safe_load_all(path.read_text(encoding="utf-8"))
    return Robot(name, text + "\n", read_anatomy(model, rest.get("physics", {})), rest.get("robot", {}))
