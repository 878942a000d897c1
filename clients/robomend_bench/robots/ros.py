"""What is measured on a real robot with ROS: nodes are killed, frozen and made silent.

Of ROS 1 rosmaster and rospy nodes of the distribution, of ROS 2 rclpy nodes of whichever Python here has
them. Where there is none nothing is measured. The time of an event is when the service accepted the
report.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from robomend_bench.robots.live import Rig
from robomend_bench.service.process import cpu_s


class NoRos(Exception):
    """There is no such ROS on this machine."""


@dataclass(frozen=True)
class RosNetwork:
    """Where nodes of one ROS live, and how one is written."""

    section: Mapping[str, Any]  # of the agent's file
    python: str
    environment: Mapping[str, str]


@dataclass(frozen=True)
class Ros:
    """One of the two. Its programs have the same arguments and answers."""

    origin: str
    python: Callable[[], str]  # raises NoRos
    network: Callable[[Path, ExitStack], RosNetwork]  # the folder takes its files
    node: str  # that RosRig starts
    words: str  # of a node that power.py writes: start, publisher, listen, spin


ROS1_PYTHON = "/usr/bin/python3"
"""The distribution's own."""

MASTER = """
import sys
from rosmaster.master import Master
master = Master(0)
master.start()
print(master.uri, flush=True)
sys.stdin.read()
"""

TALKS = """
threading.Thread(target=talk, daemon=True).start()
print("up", flush=True)
for line in sys.stdin:
    with lock:
        silent ^= {line.strip()}
        print(last_ns.get(line.strip(), 0), flush=True)
"""
"""Ends a node's script: it talks, and each line of stdin silences a topic, or has it talk again."""

ROS1_NODE = """
import sys, threading, time, rospy
from std_msgs.msg import Float64
rospy.init_node(sys.argv[1], disable_signals=True)
publishers = {t: rospy.Publisher(t, Float64, queue_size=10) for t in sys.argv[2].split(",")}
silent, last_ns, lock = set(), {}, threading.Lock()
def talk():
    rate = rospy.Rate(10)
    while True:
        for topic, publisher in publishers.items():
            with lock:
                if topic not in silent:
                    last_ns[topic] = time.time_ns()
                    publisher.publish(1.0)
        rate.sleep()
"""

ROS1_WORDS = """
import rospy
from std_msgs.msg import Float64
def start(name):
    rospy.init_node(name)
def publisher(topic):
    found = rospy.Publisher(topic, Float64, queue_size=10)
    return lambda: found.publish(1.0)
def listen(topic, heard):
    rospy.Subscriber(topic, Float64, lambda _: heard())
spin = rospy.spin
"""


def ros1_python() -> str:
    """Return the Python that has rospy; NoRos if it has none."""
    if not _has(ROS1_PYTHON, "rospy, rosmaster, std_msgs.msg"):
        raise NoRos("no rospy or rosmaster here (Debian 12: apt-get install python3-rospy python3-rosmaster)")
    return ROS1_PYTHON


def ros1_network(folder: Path, stack: ExitStack) -> RosNetwork:
    """Start a master."""
    here = {"ROS_IP": "127.0.0.1", "ROS_HOME": str(folder), "ROS_LOG_DIR": str(folder)}
    environment = {**os.environ, **here}
    uri = line(started([ROS1_PYTHON, "-c", MASTER], environment, stack))
    return RosNetwork({"master": uri}, ROS1_PYTHON, {**environment, "ROS_MASTER_URI": uri})


ROS1 = Ros("ros1", ros1_python, ros1_network, ROS1_NODE + TALKS, ROS1_WORDS)

ROS2_PYTHONS = (os.environ.get("ROBOMEND_RCLPY_PYTHON", ""), sys.executable, "/usr/bin/python3")

ROS2_NODE = """
import sys, threading, time, rclpy
from std_msgs.msg import Float64
rclpy.init()
node = rclpy.create_node(sys.argv[1])
publishers = {t: node.create_publisher(Float64, t, 10) for t in sys.argv[2].split(",")}
silent, last_ns, lock = set(), {}, threading.Lock()
def talk():
    due = time.monotonic()
    while True:
        for topic, publisher in publishers.items():
            with lock:
                if topic not in silent:
                    last_ns[topic] = time.time_ns()
                    publisher.publish(Float64(data=1.0))
        due = max(due + 0.1, time.monotonic())
        time.sleep(max(0, due - time.monotonic()))
"""

ROS2_WORDS = """
import rclpy
from rclpy.executors import ExternalShutdownException
from std_msgs.msg import Float64
def start(name):
    global node
    rclpy.init()
    node = rclpy.create_node(name)
def publisher(topic):
    found = node.create_publisher(Float64, topic, 10)
    return lambda: found.publish(Float64(data=1.0))
def listen(topic, heard):
    node.create_subscription(Float64, topic, lambda _: heard(), 10)
def spin():
    try:
        rclpy.spin(node)
    except ExternalShutdownException:
        pass
"""


def ros2_python() -> str:
    """Return a Python that has rclpy; NoRos if none here has it."""
    for candidate in filter(None, ROS2_PYTHONS):
        if _has(candidate, "rclpy, std_msgs.msg"):
            return candidate
    raise NoRos("no rclpy here (source a setup.bash of ROS 2, or name its Python in ROBOMEND_RCLPY_PYTHON)")


def choose_domain() -> int:
    """Return a domain that hardly anybody else has."""
    return os.getpid() % 100 + 1


def ros2_network(folder: Path, stack: ExitStack) -> RosNetwork:
    """Choose a domain; there is nothing to start."""
    domain = choose_domain()
    here = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    environment = {**os.environ, **here, "ROS_LOG_DIR": str(folder)}
    return RosNetwork({"domain": domain, "discovery": "localhost"}, ros2_python(), environment)


ROS2 = Ros("ros2", ros2_python, ros2_network, ROS2_NODE + TALKS, ROS2_WORDS)


def _has(python: str, modules: str) -> bool:
    try:
        return (
            subprocess.run([python, "-c", f"import {modules}"], check=False, capture_output=True).returncode
            == 0
        )
    except OSError:
        return False


class RosRig(Rig):
    """A robot whose nodes publish topics at 10 Hz.

    A node prints a line when it is up. It falls silent on a topic whose name is written to it, or talks
    again, and prints when the last message was.
    """

    def __init__(self, url: str, folder: Path, nodes: int, topics: int, ros: Ros) -> None:
        """`topics` of each node."""
        names = [f"topic{number}" for number in range(topics)]
        super().__init__(url, folder, nodes, names)
        self._ros = ros
        self._topics = {node: [f"{node}_{name}" for name in names] for node in self._nodes}
        self._processes: dict[str, subprocess.Popen[str]] = {}

    @contextmanager
    def robot(self) -> Iterator[Mapping[str, Any]]:
        """Start all nodes; yield the section of the agent's file."""
        with ExitStack() as stack:
            network = self._ros.network(self._folder, stack)
            for node, topics in self._topics.items():
                command = [
                    network.python,
                    "-c",
                    self._ros.node,
                    node,
                    ",".join(f"/{topic}" for topic in topics),
                ]
                self._processes[node] = started(command, network.environment, stack)
            for process in self._processes.values():
                line(process)
            yield network.section

    def watched(
        self, section: Mapping[str, Any], observers: Mapping[str, object]
    ) -> AbstractContextManager[subprocess.Popen[bytes]]:
        """Run the agent until it is known that all nodes run and all topics talk."""
        topics = {topic: {"first_s": 86400} for topics in self._topics.values() for topic in topics}
        origin = self._ros.origin
        nodes = {"kind": "node", "from": origin, "preset": origin, "nodes": self._nodes}
        settings = {
            "robot": "bench",
            "service": {"url": self._url},
            "bus": {"listen": self._bus},
            origin: section,
            "rate": {"from": origin},
            "topics": topics,
            "observers": {"nodes": nodes, **observers},
        }
        running = {f"running({node})": True for node in self._nodes}
        return self.running(self._folder, settings, {**running, **{f"ok({topic})": True for topic in topics}})

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
