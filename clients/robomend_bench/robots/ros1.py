"""A real ROS 1 robot under a real agent and service: rosmaster and rospy nodes of the distribution.

Where there is no ROS 1 nothing is measured.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any

from robomend_bench.robots.ros import NoRos, RosRig, line, started

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


def check() -> None:
    """Raise NoRos unless the distribution's packages are here."""
    try:
        done = subprocess.run(
            [PYTHON, "-c", "import rospy, rosmaster, std_msgs.msg"], check=False, capture_output=True
        )
    except OSError as error:
        raise NoRos(str(error)) from error
    if done.returncode:
        raise NoRos("no rospy or rosmaster here (Debian 12: apt-get install python3-rospy python3-rosmaster)")


class Ros1Rig(RosRig):
    """A robot of rospy nodes."""

    origin = "ros1"

    @contextmanager
    def robot(self) -> Iterator[Mapping[str, Any]]:
        """Start the master and all nodes; yield the section of the agent's file."""
        with ExitStack() as stack:
            here = {"ROS_IP": "127.0.0.1", "ROS_HOME": str(self._folder), "ROS_LOG_DIR": str(self._folder)}
            environment = {**os.environ, **here}
            master = started([PYTHON, "-c", MASTER], environment, stack)
            uri = line(master)
            for node, topics in self._topics.items():
                command = [PYTHON, "-c", NODE, node, ",".join(f"/{topic}" for topic in topics)]
                environment["ROS_MASTER_URI"] = uri
                self._processes[node] = started(command, environment, stack)
            for process in self._processes.values():
                line(process)
            yield {"master": uri}
