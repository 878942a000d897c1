"""A real ROS 1 for tests: rosmaster, rospy and actionlib of the distribution, installed if they are missing.

Only Debian 12 and Ubuntu up to 22.04 have them; elsewhere the tests that need them are skipped, and fail
where CI is set. The bridge itself needs none of it: this is its other side.
"""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

import pytest
from tests.network import own_port
from tests.node_process import NodeProcess
from tests.packages import ROS1, ROS1_PYTHON

NODE = Path(__file__).parent / "ros1_node.py"


_why_not = lru_cache(maxsize=1)(ROS1.install)  # it is tried once


def ros1() -> None:
    """Install what is missing, if we may; skip the test, or fail it in CI, where that is impossible."""
    why = _why_not()
    if not why:
        return
    if os.environ.get("CI"):
        pytest.fail(why)
    pytest.skip(why)


MASTER = """
import sys, time
from rosmaster.master import Master
master = Master(int(sys.argv[1]))
master.start()
print(master.uri, flush=True)
sys.stdin.read()
"""


class RosMaster:
    """A master of the distribution, on a port of its own; a restart keeps it."""

    def __init__(self, folder: Path, host: str = "127.0.0.1", inside: Sequence[str] = ()) -> None:
        """`inside` begins the command of whatever runs beside the master, where `host` is its address."""
        self.folder = folder
        self.host = host
        self.inside = tuple(inside)
        self.port = 0 if inside else own_port(host)
        self._process: subprocess.Popen[str] | None = None
        self.start()

    @property
    def uri(self) -> str:
        return f"http://{self.host}:{self.port}/"

    @property
    def environment(self) -> dict[str, str]:
        """What nodes of this master need."""
        here = {"ROS_MASTER_URI": self.uri, "ROS_IP": self.host, "PYTHONPATH": ""}
        return {**os.environ, **here, "ROS_HOME": str(self.folder), "ROS_LOG_DIR": str(self.folder)}

    def start(self) -> None:
        self._process = subprocess.Popen(
            [*self.inside, ROS1_PYTHON, "-c", MASTER, str(self.port)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env=self.environment,
        )
        assert self._process.stdout is not None
        uri = self._process.stdout.readline().strip()
        self.port = int(uri.rstrip("/").rpartition(":")[2])

    def signal(self, number: signal.Signals) -> None:
        assert self._process is not None
        self._process.send_signal(number)

    def stop(self) -> None:
        """Kill it: a master that crashed."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            for stream in (self._process.stdin, self._process.stdout):
                assert stream is not None
                stream.close()
            self._process = None


class RosNode(NodeProcess):
    """A rospy node; see ros1_node.py."""

    def __init__(
        self, master: RosMaster, name: str, inside: Sequence[str] | None = None, **environment: str
    ) -> None:
        """`inside`: as the master's; None: where the master is."""
        command = [*(master.inside if inside is None else inside), ROS1_PYTHON, str(NODE)]
        super().__init__(name, command, {**master.environment, **environment}, master.folder)


class Robot:
    """A master and nodes, which all end with the test."""

    def __init__(self, folder: Path, host: str = "127.0.0.1", inside: Sequence[str] = ()) -> None:
        """`host` and `inside`: as the master's."""
        self.master = RosMaster(folder, host, inside)
        self.nodes: dict[str, RosNode] = {}

    def node(self, name: str, inside: Sequence[str] | None = None, **environment: str) -> RosNode:
        """Start a node and wait until the master knows it."""
        node = self.nodes[name] = RosNode(self.master, name, inside, **environment)
        node.do("nothing")
        return node

    def close(self) -> None:
        for node in self.nodes.values():
            node.close()
        self.master.stop()


@contextmanager
def robot(folder: Path, host: str = "127.0.0.1", inside: Sequence[str] = ()) -> Iterator[Robot]:
    """A real ROS 1 robot; skips where there is none."""
    ros1()
    found = Robot(folder, host, inside)
    try:
        yield found
    finally:
        found.close()
