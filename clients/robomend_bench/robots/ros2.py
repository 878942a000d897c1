"""A real ROS 2 robot under a real agent and service: rclpy nodes, of whichever Python here has them.

Where there is no rclpy nothing is measured.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from robomend_bench.robots.ros import NoRos, RosNetwork, RosRig, line, started

CANDIDATES = (os.environ.get("ROBOMEND_RCLPY_PYTHON", ""), sys.executable, "/usr/bin/python3")

NODE = """
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
threading.Thread(target=talk, daemon=True).start()
print("up", flush=True)
for line in sys.stdin:
    with lock:
        silent ^= {line.strip()}
        print(last_ns.get(line.strip(), 0), flush=True)
"""


WORDS = """
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


def python() -> str:
    """Return a Python that has rclpy.

    Raises:
        NoRos: none here has it.
    """
    for candidate in filter(None, CANDIDATES):
        try:
            asked = [candidate, "-c", "import rclpy, std_msgs.msg"]
            if subprocess.run(asked, check=False, capture_output=True).returncode == 0:
                return candidate
        except OSError:
            continue
    raise NoRos("no rclpy here (source a setup.bash of ROS 2, or name its Python in ROBOMEND_RCLPY_PYTHON)")


def choose_domain() -> int:
    """Return a domain that hardly anybody else has."""
    return os.getpid() % 100 + 1


def network(folder: Path, stack: ExitStack) -> RosNetwork:
    """Choose a domain; there is nothing to start."""
    domain = choose_domain()
    here = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    environment = {**os.environ, **here, "ROS_LOG_DIR": str(folder)}
    return RosNetwork("ros2", {"domain": domain, "discovery": "localhost"}, python(), environment, WORDS)


class Ros2Rig(RosRig):
    """A robot of rclpy nodes."""

    origin = "ros2"

    @contextmanager
    def robot(self) -> Iterator[Mapping[str, Any]]:
        """Start all nodes; yield the section of the agent's file."""
        with ExitStack() as stack:
            domain = network(self._folder, stack)
            command = [domain.python, "-c", NODE]
            for node, topics in self._topics.items():
                names = ",".join(f"/{topic}" for topic in topics)
                self._processes[node] = started([*command, node, names], domain.environment, stack)
            for process in self._processes.values():
                line(process)
            yield domain.section
