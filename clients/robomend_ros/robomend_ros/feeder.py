"""The node: hands topics, fields of them, and which nodes there are to the agent's bus.

    ros2 run robomend_ros feeder --ros-args -p bus:=unix:/run/robomend/bus -p sources:=scan,odom:pose.x

It knows every type that the robot has built. In the agent's file the observers have no `from:`; of the nodes:

    nodes: {kind: node, table: nodes, nodes: [hokuyo_node], rate_hz: 1}
"""

from __future__ import annotations

import functools
import os
import time
from contextlib import suppress
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from robomend_ros.bus import Bus
from robomend_ros.types import load_message

LOOK_S = 0.5
DEPTH = 50


class Feeder(Node):  # type: ignore[misc]  # rclpy is not where types are checked
    """See the module."""

    def __init__(self) -> None:
        super().__init__("robomend_feeder")
        address = self.declare_parameter("bus", "").value or os.environ.get("ROBOMEND_BUS", "")
        self._bus = Bus(address, time.monotonic)
        self._prefix = "/" + self.declare_parameter("namespace", "/").value.strip("/") + "/"
        self._prefix = self._prefix.replace("//", "/")
        self._fields: dict[str, list[str]] = {}  # topic -> fields that are wanted of it
        for source in filter(None, self.declare_parameter("sources", "").value.split(",")):
            topic, _, field = source.strip().partition(":")
            self._fields.setdefault(topic.strip("/"), []).extend([field] if field else [])
        self._types: dict[str, str] = {}  # topic -> the type that it is listened to with
        self._told: set[str] = set()
        self.create_timer(LOOK_S, self._look)

    def _look(self) -> None:
        """Listen to what has come up, and say which nodes there are."""
        found = dict(self.get_topic_names_and_types())
        for topic in self._fields:
            kinds = found.get(self._prefix + topic, [])
            if kinds and topic not in self._types:
                self._listen(topic, kinds[-1])
        names = [f"{space.rstrip('/')}/{name}" for name, space in self.get_node_names_and_namespaces()]
        short = [name[len(self._prefix) :] if name.startswith(self._prefix) else name for name in names]
        self._bus.publish("nodes", data=sorted(set(short)))

    def _listen(self, topic: str, kind: str) -> None:
        try:
            message = load_message(kind)
        except (ImportError, AttributeError, ValueError) as error:
            self._tell(topic, f"{kind} is not built here: {error}")
            return
        lossy = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        raw = not self._fields[topic]  # nobody looks into it
        heard = functools.partial(self._heard, topic)
        self.create_subscription(message, self._prefix + topic, heard, lossy, raw=raw)
        self._types[topic] = kind

    def _heard(self, topic: str, message: Any) -> None:
        fields: dict[str, object] = {}
        for path in self._fields[topic]:
            try:
                fields[path] = value_at(message, path)
            except (AttributeError, IndexError, TypeError, ValueError):
                self._tell(f"{topic}:{path}", "there is no such field")
        if fields or not self._fields[topic]:
            self._bus.publish(topic, time_ns=time.time_ns(), fields=fields or None)

    def _tell(self, place: str, why: str) -> None:
        if place not in self._told:
            self._told.add(place)
            self.get_logger().warning(f"{place}: {why}")


def value_at(message: Any, path: str) -> float | str:
    """Return the number or text that a dotted path leads to: pose.pose.position.x, ranges.0."""
    value: Any = message
    for name in path.split("."):
        value = value[int(name)] if name.isdigit() else getattr(value, name)
    if isinstance(value, (bool, str)):
        return value
    return float(value)


def main() -> None:
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(Feeder())


if __name__ == "__main__":
    main()
