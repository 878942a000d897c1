"""A real ROS 2 for tests: rclpy and Fast DDS from wheels, in an environment of its own (packages.py).

There are wheels for x86-64 only; elsewhere the tests that need them are skipped, and fail where CI is set.
The bridge itself needs none of it: this is its other side. Each robot has a domain that no other test of this
computer has, and looks at this computer only.
"""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

import pytest
from tests.node_process import NodeProcess
from tests.packages import KILTED, WantedRos2

NODE = Path(__file__).parent / "ros2_node.py"
DOMAINS = range(1, 101)
"""Above them their ports are those that the system gives to others."""


@lru_cache(maxsize=4)  # it is tried once
def _why_not(wanted: WantedRos2) -> str:
    return wanted.install()


def ros2(wanted: WantedRos2 = KILTED) -> None:
    """Install what is missing, if we may; skip the test, or fail it in CI, where that is impossible."""
    why = _why_not(wanted)
    if why and os.environ.get("CI"):
        pytest.fail(why)
    if why:
        pytest.skip(why)


@contextmanager
def domain() -> Iterator[int]:
    """A domain of our own."""
    for number in DOMAINS:
        with (Path(tempfile.gettempdir()) / f"robomend-tests-domain-{number}.lock").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            yield number
            return
    raise AssertionError("all domains are taken")


class Ros2Robot:
    """Nodes of one domain, which all end with the test."""

    def __init__(
        self,
        folder: Path,
        number: int,
        wanted: WantedRos2,
        inside: Sequence[str] = (),
        more: Mapping[str, str] | None = None,
    ) -> None:
        """`inside` begins the command of each node, which has `more` in its environment."""
        self.folder = folder
        self.domain = number
        self.python = wanted.python
        self._inside = tuple(inside)
        self._more = more or {}
        self.nodes: dict[str, NodeProcess] = {}

    @property
    def environment(self) -> dict[str, str]:
        """What its nodes, and those who look at it, need."""
        here = {"ROS_DOMAIN_ID": str(self.domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        return {**os.environ, **here, "ROS_LOG_DIR": str(self.folder), "PYTHONPATH": "", **self._more}

    def node(self, name: str) -> NodeProcess:
        """Start a node and wait until it is up."""
        command = [*self._inside, str(self.python), str(NODE)]
        node = self.nodes[name] = NodeProcess(name, command, self.environment, self.folder)
        node.do("nothing")
        return node

    def close(self) -> None:
        for node in self.nodes.values():
            node.close()


@contextmanager
def robot(
    folder: Path,
    wanted: WantedRos2 = KILTED,
    inside: Sequence[str] = (),
    more: Mapping[str, str] | None = None,
) -> Iterator[Ros2Robot]:
    """A real ROS 2 robot; skips where there is none. The rest is as Ros2Robot's."""
    ros2(wanted)
    with domain() as number:
        found = Ros2Robot(folder, number, wanted, inside, more)
        try:
            yield found
        finally:
            found.close()
