"""A real ROS 2 robot under a real agent and service: rclpy nodes, of whichever Python here has them.

Where there is no rclpy nothing is measured.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any

from robomend_bench.robots.ros import NoRos, RosRig, line, started

CANDIDATES = (os.environ.get("ROBOMEND_RCLPY_PYTHON", ""), sys.executable, "/usr/bin/python3")

NODE = """
import sys, threading, time, rclpy
from std_msgs.msg import Float64
rclpy.init()
node = rclpy.create_node(sys.argv[1])
talking = {t: node.create_publisher(Float64, t, 10) for t in sys.argv[2].split(",")}
def talk():
    due = time.monotonic()
    while True:
        for publisher in tuple(talking.values()):
            publisher.publish(Float64(data=1.0))
        due = max(due + 0.1, time.monotonic())
        time.sleep(max(0, due - time.monotonic()))
threading.Thread(target=talk, daemon=True).start()
print("up", flush=True)
for line in sys.stdin:
    talking.pop(line.strip())
    print(time.time_ns(), flush=True)
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


class Ros2Rig(RosRig):
    """A robot of rclpy nodes."""

    origin = "ros2"

    @contextmanager
    def robot(self) -> Iterator[Mapping[str, Any]]:
        """Start all nodes; yield the section of the agent's file."""
        domain = os.getpid() % 100 + 1
        here = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        environment = {**os.environ, **here, "ROS_LOG_DIR": str(self._folder)}
        command = [python(), "-c", NODE]
        with ExitStack() as stack:
            for node, topics in self._topics.items():
                names = ",".join(f"/{topic}" for topic in topics)
                self._processes[node] = started([*command, node, names], environment, stack)
            for process in self._processes.values():
                line(process)
            yield {"domain": domain, "discovery": "localhost"}
