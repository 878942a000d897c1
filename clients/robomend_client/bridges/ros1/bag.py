"""The graph that a ROS 1 recording shows: who published what, how often. It does not know who listened."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

from rosbags.rosbag1 import Reader

from robomend_client.ros_graph import RosGraph

UNKNOWN = "/unknown_publisher"
"""The node of topics whose publisher the recording does not name."""

LEAST = 10
"""Messages without which there is no rate."""


class UnreadableBag(Exception):
    """The file is no bag that can be read; the message says why."""


def bag_graph(file: Path) -> RosGraph:
    """Return the graph of a bag; of its messages only the index is read.

    Raises:
        UnreadableBag: it is none.
    """
    publishers: dict[str, set[str]] = defaultdict(set)
    times_ns: dict[str, list[int]] = defaultdict(list)
    types: dict[str, str] = {}
    try:
        with Reader(file) as reader:
            for connection in reader.connections:
                caller = getattr(connection.ext, "callerid", None) or UNKNOWN
                caller = "/" + caller.strip("/")
                played = caller.startswith("/play_")  # a recording of a recording
                publishers[connection.topic].add(UNKNOWN if played else caller)
                times_ns[connection.topic] += [entry.time for entry in reader.indexes[connection.id]]
                types[connection.topic] = connection.msgtype.replace("/msg/", "/")
    except Exception as error:  # rosbags raises what the bytes of a broken file make it
        raise UnreadableBag(f"{file}: cannot be read as a ROS 1 bag: {error}") from error
    rates = {}
    for topic, times in times_ns.items():  # it may have come up late, or ended early
        span_s = (max(times, default=0) - min(times, default=0)) / 1e9
        if len(times) >= LEAST and span_s > 0:
            rates[topic] = (len(times) - 1) / span_s
    return RosGraph(
        {topic: frozenset(nodes) for topic, nodes in publishers.items()}, types=types, rates_hz=rates
    )
