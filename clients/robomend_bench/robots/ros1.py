"""A real ROS 1 robot under a real agent and service: rosmaster and rospy nodes of the distribution.

Nodes are killed, frozen and made silent; the time of an event is the one at which the service accepted the
report. Where there is no ROS 1 nothing is measured.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from robomend_bench.robots.live import WITHIN_S, Rig
from robomend_bench.service.measure import cpu_s

PYTHON = "/usr/bin/python3"
"""The distribution's own."""

MASTER = """
import sys
from rosmaster.master import Master
master = Master(0)
master.start()
print(master.uri, flush=True)
sys.stdin.read()
"""

NODE = """
import sys, threading, time, rospy
from std_msgs.msg import Float64
rospy.init_node(sys.argv[1], disable_signals=True)
talking = {t: rospy.Publisher(t, Float64, queue_size=10) for t in sys.argv[2].split(",")}
def talk():
    rate = rospy.Rate(10)
    while True:
        for publisher in tuple(talking.values()):
            publisher.publish(1.0)
        rate.sleep()
threading.Thread(target=talk, daemon=True).start()
print("up", flush=True)
for line in sys.stdin:
    talking.pop(line.strip())
    print(time.time_ns(), flush=True)
"""


class NoRos1(Exception):
    """There is no ROS 1 on this machine."""


def check() -> None:
    """Raise NoRos1 unless the distribution's packages are here."""
    try:
        done = subprocess.run(
            [PYTHON, "-c", "import rospy, rosmaster, std_msgs.msg"], check=False, capture_output=True
        )
    except OSError as error:
        raise NoRos1(str(error)) from error
    if done.returncode:
        raise NoRos1(
            "no rospy or rosmaster here (Debian 12: apt-get install python3-rospy python3-rosmaster)"
        )


class Ros1Rig(Rig):
    """A robot of rospy nodes that publish topics at 10 Hz."""

    def __init__(self, url: str, folder: Path, nodes: int, topics: int) -> None:
        """`topics` of each node."""
        names = [f"topic{number}" for number in range(topics)]
        super().__init__(url, folder, nodes, names)
        self._topics = {node: [f"{node}_{name}" for name in names] for node in self._nodes}
        self._processes: dict[str, subprocess.Popen[str]] = {}

    @contextmanager
    def robot(self) -> Iterator[str]:
        """Start the master and all nodes; yield the master's address."""
        with ExitStack() as stack:
            here = {"ROS_IP": "127.0.0.1", "ROS_HOME": str(self._folder), "ROS_LOG_DIR": str(self._folder)}
            environment = {**os.environ, **here}
            master = _started([MASTER], environment, stack)
            uri = _line(master)
            for node, topics in self._topics.items():
                command = [NODE, node, ",".join(f"/{topic}" for topic in topics)]
                environment["ROS_MASTER_URI"] = uri
                self._processes[node] = _started(command, environment, stack)
            for process in self._processes.values():
                _line(process)
            yield uri

    @contextmanager
    def watched(self, uri: str, observers: Mapping[str, object]) -> Iterator[subprocess.Popen[bytes]]:
        """Run the agent until it is known that all nodes run and all topics talk."""
        topics = {topic: {"first_s": 86400} for topics in self._topics.values() for topic in topics}
        nodes = {"kind": "node", "from": "ros1", "preset": "ros1", "nodes": self._nodes}
        settings = {
            "robot": "bench",
            "service": {"url": self._url},
            "state_dir": str(self._folder / "state"),
            "bus": {"listen": self._bus},
            "ros1": {"master": uri},
            "rate": {"from": "ros1"},
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
            process = self._processes[node]
            assert process.stdin is not None
            process.stdin.write(f"/{topic}\n")
            process.stdin.flush()
            hushed_ns = int(_line(process))
            found.append((self.told({f"ok({topic})": False}) - hushed_ns) / 1e9)
        return sorted(found)

    def ended_s(self, seed: int) -> list[float]:
        """Kill each node (SIGKILL); return the times until the service knew, sorted."""
        found = []
        for node in self._moments(seed):
            began_ns = time.time_ns()
            self._processes[node].kill()
            found.append((self.told({f"running({node})": False}) - began_ns) / 1e9)
        return sorted(found)

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


def _started(command: list[str], environment: dict[str, str], stack: ExitStack) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [PYTHON, "-c", *command],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=environment,
    )
    stack.callback(process.wait)
    stack.callback(process.kill)
    return process


def _line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()
