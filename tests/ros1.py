"""A real ROS 1 for tests: rosmaster, rospy and actionlib of the distribution, installed if they are missing.

Only Debian 12 and Ubuntu up to 22.04 have them; elsewhere the tests that need them are skipped, and fail
where CI is set. The bridge itself needs none of it: this is its other side.
"""

from __future__ import annotations

import fcntl
import json
import os
import queue
import shutil
import signal
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest

PYTHON = "/usr/bin/python3"
"""The distribution's own: rospy is a package of it."""

NODE = Path(__file__).parent / "ros1_node.py"
PACKAGES = [
    *("python3-rospy", "python3-rosmaster", "python3-actionlib", "python3-rosbag", "python3-genpy"),
    *("python3-std-msgs", "python3-diagnostic-msgs", "python3-geometry-msgs"),
]

UP = "import rospy, rosmaster.master, actionlib, rosbag, genpy.dynamic, diagnostic_msgs, geometry_msgs"
WAIT_S = 60.0


@lru_cache(maxsize=1)
def ros1() -> None:
    """Install what is missing, if we may; skip the test, or fail it in CI, where that is impossible."""
    if _is_there():
        return
    why = "ROS 1 is not to be had here"
    if os.geteuid() == 0 and shutil.which("apt-get"):
        with (Path(tempfile.gettempdir()) / "robomend-tests-ros1.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # one of the workers installs, the others wait
            if _is_there():
                return
            apt = ["apt-get", "-q", "-y", "-o", "DPkg::Lock::Timeout=300"]
            quiet = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
            subprocess.run([*apt, "update"], check=False, capture_output=True, timeout=300, env=quiet)
            install = [*apt, "install", "--no-install-recommends", *PACKAGES]
            done = subprocess.run(
                install, check=False, capture_output=True, text=True, timeout=600, env=quiet
            )
            if _is_there():
                return
            why = f"{why}: {done.stderr.strip()[-300:]}"
    if os.environ.get("CI"):
        pytest.fail(why)
    pytest.skip(why)


def _is_there() -> bool:
    try:
        return subprocess.run([PYTHON, "-c", UP], check=False, capture_output=True).returncode == 0
    except OSError:
        return False


MASTER = """
import sys, time
from rosmaster.master import Master
master = Master(int(sys.argv[1]))
master.start()
print(master.uri, flush=True)
sys.stdin.read()
"""


class RosMaster:
    """A master of the distribution, on a port that the system chooses; a restart keeps it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.port = 0
        self._process: subprocess.Popen[str] | None = None
        self.start()

    @property
    def uri(self) -> str:
        return f"http://127.0.0.1:{self.port}/"

    @property
    def environment(self) -> dict[str, str]:
        """What nodes of this master need."""
        here = {"ROS_MASTER_URI": self.uri, "ROS_IP": "127.0.0.1", "PYTHONPATH": ""}
        return {**os.environ, **here, "ROS_HOME": str(self.folder), "ROS_LOG_DIR": str(self.folder)}

    def start(self) -> None:
        self._process = subprocess.Popen(
            [PYTHON, "-c", MASTER, str(self.port)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env=self.environment,
        )
        assert self._process.stdout is not None
        uri = self._process.stdout.readline().strip()
        self.port = int(uri.rstrip("/").rpartition(":")[2])

    def stop(self) -> None:
        """Kill it: a master that crashed."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            for stream in (self._process.stdin, self._process.stdout):
                assert stream is not None
                stream.close()
            self._process = None


class RosNode:
    """A rospy node in a process of its own, told by lines of JSON what to do; see ros1_node.py."""

    def __init__(self, master: RosMaster, name: str, **environment: str) -> None:
        self.name = name
        self._answers: queue.Queue[dict[str, Any]] = queue.Queue()
        self.heard: list[dict[str, Any]] = []
        self.process = subprocess.Popen(
            [PYTHON, str(NODE), name],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=(master.folder / f"{name}.log").open("ab"),
            text=True,
            env={**master.environment, **environment},
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def pid(self) -> int:
        return self.process.pid

    def do(self, what: str, **arguments: Any) -> Any:
        """Tell the node to do something, and wait until it has."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps({"do": what, **arguments}) + "\n")
        self.process.stdin.flush()
        answer = self._answers.get(timeout=WAIT_S)
        assert "error" not in answer, answer["error"]
        return answer.get("answer")

    def kill(self) -> None:
        """kill -9"""
        self.process.kill()
        self.process.wait()

    def signal(self, number: signal.Signals) -> None:
        self.process.send_signal(number)

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGCONT)
            self.kill()
        self._reader.join()
        for stream in (self.process.stdin, self.process.stdout):
            assert stream is not None
            with suppress(BrokenPipeError):
                stream.close()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            value = json.loads(line)
            if "heard" in value:
                self.heard.append(value)
            else:
                self._answers.put(value)


class Robot:
    """A master and nodes, which all end with the test."""

    def __init__(self, folder: Path) -> None:
        self.master = RosMaster(folder)
        self.nodes: dict[str, RosNode] = {}

    def node(self, name: str, **environment: str) -> RosNode:
        """Start a node and wait until the master knows it."""
        node = self.nodes[name] = RosNode(self.master, name, **environment)
        node.do("nothing")
        return node

    def close(self) -> None:
        for node in self.nodes.values():
            node.close()
        self.master.stop()


@contextmanager
def robot(folder: Path) -> Iterator[Robot]:
    """A real ROS 1 robot; skips where there is none."""
    ros1()
    found = Robot(folder)
    try:
        yield found
    finally:
        found.close()
