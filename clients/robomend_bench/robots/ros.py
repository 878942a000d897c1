"""What is measured on a real robot with ROS, whichever: nodes are killed, frozen and made silent.

The time of an event is the one at which the service accepted the report.
"""

from __future__ import annotations

import json
import random
import signal
import subprocess
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from robomend_bench.robots.live import WITHIN_S, Rig
from robomend_bench.service.process import cpu_s


class NoRos(Exception):
    """There is no such ROS on this machine."""


@dataclass(frozen=True)
class RosNetwork:
    """Where nodes of one ROS live, and how one is written."""

    origin: str
    section: Mapping[str, Any]  # of the agent's file
    python: str
    environment: Mapping[str, str]
    words: str  # of a node: start, publisher, listen, spin


class RosRig(Rig, ABC):
    """A robot whose nodes publish topics at 10 Hz; the subclass starts them.

    A node prints a line when it is up. It falls silent on a topic whose name is written to it, or talks
    again, and prints when the last message was.
    """

    origin: str

    def __init__(self, url: str, folder: Path, nodes: int, topics: int) -> None:
        """`topics` of each node."""
        names = [f"topic{number}" for number in range(topics)]
        super().__init__(url, folder, nodes, names)
        self._topics = {node: [f"{node}_{name}" for name in names] for node in self._nodes}
        self._processes: dict[str, subprocess.Popen[str]] = {}

    @abstractmethod
    def robot(self) -> AbstractContextManager[Mapping[str, Any]]:
        """Start the robot; yield the section of the agent's file."""

    @contextmanager
    def watched(
        self, section: Mapping[str, Any], observers: Mapping[str, object]
    ) -> Iterator[subprocess.Popen[bytes]]:
        """Run the agent until it is known that all nodes run and all topics talk."""
        topics = {topic: {"first_s": 86400} for topics in self._topics.values() for topic in topics}
        nodes = {"kind": "node", "from": self.origin, "preset": self.origin, "nodes": self._nodes}
        settings = {
            "robot": "bench",
            "service": {"url": self._url},
            "state_dir": str(self._folder / "state"),
            "bus": {"listen": self._bus},
            self.origin: section,
            "rate": {"from": self.origin},
            "topics": topics,
            "observers": {"nodes": nodes, **observers},
        }
        file = self._folder / "agent.yaml"
        file.write_text(json.dumps(settings))
        with (self._folder / "agent.log").open("wb") as log:
            command = [sys.executable, "-m", "robomend_client.agent.main", str(file)]
            process = subprocess.Popen(command, stderr=log)
        try:
            wanted = {f"running({node})": True for node in self._nodes}
            self.told({**wanted, **{f"ok({topic})": True for topic in topics}})
            yield process
        finally:
            process.terminate()
            process.wait(WITHIN_S)

    def frozen_s(self, seed: int) -> list[float]:
        """Stop each node (SIGSTOP) and let it go on; return the times until the service knew, sorted."""
        found = []
        for node in self._moments(seed):
            began_ns = time.time_ns()
            self._processes[node].send_signal(signal.SIGSTOP)
            found.append((self.told({f"running({node})": False}) - began_ns) / 1e9)
            self._processes[node].send_signal(signal.SIGCONT)
            talk_again = {f"ok({topic})": True for topic in self._topics[node]}
            self.told({f"running({node})": True, **talk_again})
        return sorted(found)

    def hushed_s(self, seed: int) -> list[float]:
        """Let one topic of each node fall silent; return the times until the service knew, sorted."""
        found = []
        for node in self._moments(seed):
            topic = self._topics[node][-1]
            found.append(self.silence_s(topic, partial(self._switch, node, topic)))
        return sorted(found)

    def ended_s(self, seed: int) -> list[float]:
        """Kill each node (SIGKILL); return the times until the service knew, sorted."""
        found = []
        for node in self._moments(seed):
            began_ns = time.time_ns()
            self._processes[node].kill()
            found.append((self.told({f"running({node})": False}) - began_ns) / 1e9)
        return sorted(found)

    def _switch(self, node: str, topic: str) -> int:
        """Silence a topic, or let it talk again; return when its last message was."""
        process = self._processes[node]
        assert process.stdin is not None
        process.stdin.write(f"/{topic}\n")
        process.stdin.flush()
        return int(line(process))

    def _moments(self, seed: int) -> Iterator[str]:
        draw = random.Random(seed)
        for node in self._nodes:
            time.sleep(draw.uniform(0.3, 1.3))  # anywhere in the bridge's periods
            yield node


def share_of_a_core(pid: int, over_s: float) -> float:
    """Return the processor time of a process, as a part of one core."""
    before, began = cpu_s(pid), time.monotonic()
    time.sleep(over_s)
    return (cpu_s(pid) - before) / (time.monotonic() - began)


def started(command: list[str], environment: Mapping[str, str], stack: ExitStack) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=environment,
    )
    stack.callback(process.wait)
    stack.callback(process.kill)
    return process


def line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()
