"""Recordings of messages for tests, in every format: a robot that drives, and what goes wrong with it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from robomend_client.bridges.ros1.formats import BOARD, DEFINITIONS, PACKAGE
from robomend_client.bridges.ros1.messages import full_name
from robomend_client.observers.base import SECOND

ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
for _store in (ROS1, ROS2):
    for _name in (f"{PACKAGE}/Channel", BOARD):
        _store.register(get_types_from_msg(DEFINITIONS[_name], full_name(_name)))
EPOCH_NS = 1_764_000_000 * SECOND

Sample = tuple[float, str, Any]
"""Seconds, topic, value."""

KINDS = {"odom": "nav_msgs/msg/Odometry", "scan": "sensor_msgs/msg/Range", "imu": "sensor_msgs/msg/Imu"}
KINDS |= {"diagnostics": "diagnostic_msgs/msg/DiagnosticArray", "temperature": "std_msgs/msg/Float64"}
KINDS |= {"board_measurments": full_name(BOARD)}


def steady(topic: str, hz: float, end_s: float, value: float = 0.0, start_s: float = 0.0) -> list[Sample]:
    """Return messages at a rate."""
    count = round((end_s - start_s) * hz)
    return [(start_s + number / hz, topic, value) for number in range(count)]


def message(store: Any, topic: str, value: Any, stamp_ns: int, name: str) -> Any:
    """Return a message of a topic's type with a value in the field that tests look at."""
    t = store.types
    seconds, nanoseconds = divmod(stamp_ns, SECOND)
    stamp = t["builtin_interfaces/msg/Time"](sec=int(seconds), nanosec=int(nanoseconds))
    extra = {"seq": 7} if "seq" in dict(store.fielddefs["std_msgs/msg/Header"][1]) else {}
    header = t["std_msgs/msg/Header"](stamp=stamp, frame_id=name, **extra)
    zero = t["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    turning = t["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=value if isinstance(value, float) else 0.0)
    straight = t["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
    if topic == "odom":
        pose = t["geometry_msgs/msg/Pose"](
            position=t["geometry_msgs/msg/Point"](x=1.0, y=2.0, z=3.0), orientation=straight
        )
        covariance = np.zeros(36)
        return t["nav_msgs/msg/Odometry"](
            header=header,
            child_frame_id="base",
            pose=t["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=covariance),
            twist=t["geometry_msgs/msg/TwistWithCovariance"](
                twist=t["geometry_msgs/msg/Twist"](linear=zero, angular=turning), covariance=covariance
            ),
        )
    if topic == "imu":
        nine = np.zeros(9)
        return t["sensor_msgs/msg/Imu"](
            header=header,
            orientation=straight,
            orientation_covariance=nine,
            angular_velocity=turning,
            angular_velocity_covariance=nine,
            linear_acceleration=zero,
            linear_acceleration_covariance=nine,
        )
    if topic == "diagnostics":
        pair = t["diagnostic_msgs/msg/KeyValue"](key="temperature", value=str(value))
        status = t["diagnostic_msgs/msg/DiagnosticStatus"](
            level=2 if value > 60 else 0,
            name="hokuyo: temperature",
            message="",
            hardware_id="h",
            values=[pair],
        )
        return t["diagnostic_msgs/msg/DiagnosticArray"](header=header, status=[status])
    if topic == "board_measurments":
        channels = [t[full_name(f"{PACKAGE}/Channel")](**row) for row in value]
        return t[full_name(BOARD)](o_time=0.0, channel=channels)
    if topic == "scan":
        return t["sensor_msgs/msg/Range"](
            header=header,
            radiation_type=1,
            field_of_view=0.1,
            min_range=0.0,
            max_range=9.0,
            range=float(value or 0),
        )
    return t["std_msgs/msg/Float64"](data=float(value))


def write_bag(
    file: Path,
    samples: Iterable[Sample],
    *,
    stamp_s: float = 0.0,
    silent: Iterable[str] = (),
    chunk_bytes: int = 1 << 20,
    namespace: str = "",
) -> Path:
    """Write a ROS 1 bag; headers are stamped `stamp_s` after the record."""
    samples = sorted(samples, key=lambda sample: sample[0])
    writer = Writer1(file)
    writer.chunk_threshold = chunk_bytes
    with writer:
        connections = {
            topic: writer.add_connection(f"{namespace}/{topic}", KINDS[topic], typestore=ROS1)
            for topic in dict.fromkeys([*(topic for _, topic, _ in samples), *silent])
        }
        for number, (time, topic, value) in enumerate(samples):
            at_ns = EPOCH_NS + round(time * SECOND)
            made = message(ROS1, topic, value, at_ns + round(stamp_s * SECOND), "x" * (number % 5))
            writer.write(connections[topic], at_ns, ROS1.serialize_ros1(made, KINDS[topic]))
    return file


def write_ros2(file: Path, samples: Iterable[Sample], *, stamp_s: float = 0.0) -> Path:
    """Write an .mcap or .db3, by the ending of its name."""
    samples = sorted(samples, key=lambda sample: sample[0])
    folder = file.with_name(file.name + ".folder")
    plugin = StoragePlugin.MCAP if file.suffix == ".mcap" else StoragePlugin.SQLITE3
    writer = Writer2(folder, version=9, storage_plugin=plugin)
    with writer:
        connections = {
            topic: writer.add_connection(f"/{topic}", KINDS[topic], typestore=ROS2)
            for topic in dict.fromkeys(topic for _, topic, _ in samples)
        }
        for number, (time, topic, value) in enumerate(samples):
            at_ns = EPOCH_NS + round(time * SECOND)
            made = message(ROS2, topic, value, at_ns + round(stamp_s * SECOND), "x" * (number % 5))
            writer.write(connections[topic], at_ns, ROS2.serialize_cdr(made, KINDS[topic]))
    (written,) = folder.glob(f"*{file.suffix}*")
    written.rename(file)
    return file


def write(file: Path, samples: Iterable[Sample], *, stamp_s: float = 0.0) -> Path:
    """Write a recording in the format of its name."""
    if file.suffix == ".bag":
        return write_bag(file, samples, stamp_s=stamp_s)
    return write_ros2(file, samples, stamp_s=stamp_s)
