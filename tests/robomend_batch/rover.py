"""A rover: its model, its observers, a drive in which things go wrong, and what was told of it."""

from __future__ import annotations

from pathlib import Path
from typing import IO, Any

from mcap.writer import Writer as McapWriter
from tests.robomend_batch.recordings import EPOCH_NS, KINDS, ROS2, Sample, message, steady
from tests.robomend_batch.running import intervals

from robomend_client.observers.base import SECOND

MODEL = """
robomend: 1
name: rover
hardware: {base: {}, lidar: {}}
nodes:
  base_node: {drives: [base], publishes: {odom: []}}
  lidar_node: {drives: [lidar], publishes: {scan: []}}
  imu_node: {publishes: {imu: []}}
properties: {hokuyo: {}}
values:
  odom_yaw: {topic: odom, field: twist.twist.angular.z}
rules: ["not ab(lidar) -> ok(hokuyo)", "not ab(imu_node) -> not inc(odom_yaw)"]
"""

OBSERVERS = """
topics:
  odom: {rate_hz: 20, tolerance_hz: 3}
  scan: {rate_hz: 10, tolerance_hz: 2}
observers:
  odom_yaw: {kind: qualitative, source: "odom:twist.twist.angular.z", slope: 0.1}
  hokuyo: {kind: diagnostic, status: ["hokuyo: *"]}
"""


def drive(end_s: float = 8.0) -> list[Sample]:
    """A drive in which the scan falls silent from 3 to 5 s, the base turns ever faster from 6 s on."""
    scan = [sample for sample in steady("scan", 10, end_s) if not 3 <= sample[0] < 5]
    odom = [(time, "odom", max(0.0, time - 6.0)) for time, _, _ in steady("odom", 20, end_s)]
    hot = [(time, "diagnostics", 40.0) for time, _, _ in steady("diagnostics", 1, end_s)]
    return [*scan, *odom, *hot]


def drive_in_chunks(
    file: IO[bytes],
    samples: list[Sample],
    in_order: bool = True,
    topics: tuple[str, ...] = ("odom", "scan"),
    **options: Any,
) -> None:
    """Write samples of topics as an MCAP file of small chunks, in the order of their times or as given."""
    writer = McapWriter(file, **{"chunk_size": 4000, **options})
    writer.start(profile="ros2", library="test")
    channels = {}
    for topic in topics:
        name = KINDS[topic]
        text, _ = ROS2.generate_msgdef(name, ros_version=2)
        schema = writer.register_schema(name, "ros2msg", text.encode())
        channels[topic] = writer.register_channel(f"/{topic}", "cdr", schema)
    for at_s, topic, value in sorted(samples, key=lambda sample: sample[0] * in_order):
        if topic in channels:
            at_ns = EPOCH_NS + round(at_s * SECOND)
            body = bytes(ROS2.serialize_cdr(message(ROS2, topic, value, at_ns, "base"), KINDS[topic]))
            writer.add_message(channels[topic], at_ns, body, at_ns)
    writer.finish()  # type: ignore[no-untyped-call]  # the library's


def told(out: Path) -> list[tuple[float, str, object]]:
    """Return the beginnings of intervals in seconds of the drive."""
    return [((one["start_ns"] - EPOCH_NS) / SECOND, one["state"], one["bad"]) for one in intervals(out)]
