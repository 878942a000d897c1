"""Recordings of messages for tests, in every format: a robot that drives, and what goes wrong with it."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
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


def made(store: Any, kind: str, given: dict[str, Any]) -> Any:
    """Return a message of these fields; the others are empty."""
    values: dict[str, Any] = {}
    for name, (shape, inside) in store.fielddefs[kind][1]:
        value: Any = given.get(name)
        if shape == 1:
            values[name] = ("" if inside[0] == "string" else 0) if value is None else value
        elif shape == 2:
            values[name] = made(store, inside, value or {})
        else:
            (element, of), count = inside
            items: Any = value if value is not None else [0] * (count or 0)
            if element == 2:
                values[name] = [made(store, of, item) for item in items]
            elif of[0] == "string":
                values[name] = list(items)
            else:
                values[name] = np.array(items, dtype={"byte": "uint8"}.get(of[0], of[0]))
    return store.types[kind](**values)


def message(store: Any, topic: str, value: Any, stamp_ns: int, name: str) -> Any:
    """Return a message of a topic's type with a value in the field that tests look at."""
    seconds, nanoseconds = divmod(stamp_ns, SECOND)
    stamp = {"sec": int(seconds), "nanosec": int(nanoseconds)}
    fields: dict[str, Any] = {"header": {"stamp": stamp, "frame_id": name, "seq": 7}}
    turning = {"z": value if isinstance(value, float) else 0.0}
    if topic == "odom":
        pose = {"position": {"x": 1.0, "y": 2.0, "z": 3.0}, "orientation": {"w": 1.0}}
        fields |= {"child_frame_id": "base", "pose": {"pose": pose}, "twist": {"twist": {"angular": turning}}}
    elif topic == "imu":
        fields |= {"orientation": {"w": 1.0}, "angular_velocity": turning}
    elif topic == "diagnostics":
        pair = {"key": "temperature", "value": str(value)}
        level = 2 if value > 60 else 0
        status = {"level": level, "name": "hokuyo: temperature", "hardware_id": "h", "values": [pair]}
        fields["status"] = [status]
    elif topic == "board_measurments":
        fields["channel"] = value
    elif topic == "scan":
        fields |= {"radiation_type": 1, "field_of_view": 0.1, "max_range": 9.0, "range": float(value or 0)}
    else:
        fields["data"] = float(value)
    return made(store, KINDS[topic], fields)


class Recorder:
    """Messages of a robot, for a file in the format of its name."""

    def __init__(self, file: Path, *, compression: str = "", chunk_bytes: int = 1 << 20) -> None:
        self.file, self.cdr = file, file.suffix != ".bag"
        self.store = ROS2 if self.cdr else ROS1
        self._compression, self._chunk_bytes = compression, chunk_bytes
        self._messages: list[tuple[float, str, str, Any]] = []

    def __call__(self, at_s: float, topic: str, kind: str, **fields: Any) -> None:
        self.add(at_s, topic, kind, made(self.store, kind, fields))

    def add(self, at_s: float, topic: str, kind: str, message: Any) -> None:
        self._messages.append((at_s, topic, kind, message))

    def write(self, silent: Iterable[tuple[str, str]] = ()) -> Path:
        """Write the file, with topics and types of which there are no messages beside."""
        folder = self.file.with_name(self.file.name + ".folder")
        writer: Any
        if self.cdr:
            plugin = StoragePlugin.MCAP if self.file.suffix == ".mcap" else StoragePlugin.SQLITE3
            writer = Writer2(folder, version=9, storage_plugin=plugin)
            if self._compression:
                writer.set_compression(CompressionMode.MESSAGE, CompressionFormat[self._compression])
        else:
            writer = Writer1(self.file)
            writer.chunk_threshold = self._chunk_bytes
            if self._compression:
                writer.set_compression(Writer1.CompressionFormat[self._compression])
        serialize = self.store.serialize_cdr if self.cdr else self.store.serialize_ros1
        ordered = sorted(self._messages, key=lambda one: one[0])
        with writer:
            of = {
                topic: writer.add_connection(topic, kind, typestore=self.store)
                for topic, kind in dict.fromkeys([*((one[1], one[2]) for one in ordered), *silent])
            }
            for at_s, topic, kind, message in ordered:
                writer.write(of[topic], EPOCH_NS + round(at_s * SECOND), serialize(message, kind))
        if self.cdr:
            (written,) = folder.glob(f"*{self.file.suffix}*")
            written.rename(self.file)
            shutil.rmtree(folder)
        return self.file


def write(
    file: Path,
    samples: Iterable[Sample],
    *,
    stamp_s: float = 0.0,
    silent: Iterable[str] = (),
    namespace: str = "",
    **options: Any,
) -> Path:
    """Write a recording in the format of its name; headers are stamped `stamp_s` after the record."""
    record = Recorder(file, **options)
    for number, (time, topic, value) in enumerate(sorted(samples, key=lambda sample: sample[0])):
        stamp_ns = EPOCH_NS + round((time + stamp_s) * SECOND)
        one = message(record.store, topic, value, stamp_ns, "x" * (number % 5))
        record.add(time, f"{namespace}/{topic}", KINDS[topic], one)
    return record.write([(f"{namespace}/{topic}", KINDS[topic]) for topic in silent])
