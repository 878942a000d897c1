"""A robot of each kind, for tests of what the bridges have in common."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.node_process import NodeProcess
from tests.ros1 import robot as ros1_robot
from tests.ros2 import robot as ros2_robot
from tests.zenoh_robot import robot as zenoh_robot

ORIGINS = ("ros1", "ros2", "zenoh")
PRESETS = {"ros1": "ros1", "ros2": "ros2", "zenoh": "ros2"}
"""Of node observers."""


@dataclass(frozen=True)
class AnyRobot:
    """Its nodes are yet to be started."""

    origin: str
    node: Callable[[str], NodeProcess]  # starts one
    section: dict[str, Any]  # of the agent's file
    nodes: Mapping[str, NodeProcess]  # those that were started

    @property
    def watched(self) -> dict[str, str]:
        """The keys of an observer of nodes."""
        return {"kind": "node", "from": self.origin, "preset": PRESETS[self.origin]}


@contextmanager
def any_robot(origin: str, folder: Path) -> Iterator[AnyRobot]:
    """A robot of this kind; skips where there is none."""
    if origin == "ros1":
        with ros1_robot(folder) as old:
            yield AnyRobot(origin, old.node, {"master": old.master.uri}, old.nodes)
    elif origin == "ros2":
        with ros2_robot(folder) as new:
            section = {"domain": new.domain, "discovery": "localhost"}
            yield AnyRobot(origin, new.node, section, new.nodes)
    else:
        with zenoh_robot(folder) as spoken:
            section = {"connect": [spoken.endpoint], "discovery_s": 0.5}
            yield AnyRobot(origin, spoken.node, section, spoken.nodes)
