"""A real ROS 1 robot under a real agent and service: rosmaster and rospy nodes of the distribution.

Where there is no ROS 1 nothing is measured.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from robomend_bench.robots.ros import NoRos, RosNetwork, RosRig, line, started

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
threading.Thread(target=talk, daemon=True).start()
print("up", flush=True)
for line in sys.stdin:
    with lock:
        silent ^= {line.strip()}
        print(last_ns.get(line.strip(), 0), flush=True)
"""


WORDS = """
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


def network(folder: Path, stack: ExitStack) -> RosNetwork:
    """Start a master; `folder` takes its files."""
    here = {"ROS_IP": "127.0.0.1", "ROS_HOME": str(folder), "ROS_LOG_DIR": str(folder)}
    environment = {**os.environ, **here}
    uri = line(started([PYTHON, "-c", MASTER], environment, stack))
    return RosNetwork("ros1", {"master": uri}, PYTHON, {**environment, "ROS_MASTER_URI": uri}, WORDS)


class Ros1Rig(RosRig):
    """A robot of rospy nodes."""

    origin = "ros1"

    @contextmanager
    def robot(self) -> Iterator[Mapping[str, Any]]:
        """Start the master and all nodes; yield the section of the agent's file."""
        with ExitStack() as stack:
            master = network(self._folder, stack)
            for node, topics in self._topics.items():
                command = [PYTHON, "-c", NODE, node, ",".join(f"/{topic}" for topic in topics)]
                self._processes[node] = started(command, master.environment, stack)
            for process in self._processes.values():
                line(process)
            yield master.section
