"""Write a ROS 1 bag of a recording that was published as a CSV file for each topic, as bagpy and others do.

    python csv_to_bag.py run.bag run/odom.csv=/odom:nav_msgs/Odometry run/imu.csv=/imu:sensor_msgs/Imu

`Time` is a message's, in seconds since the epoch. Any other column is a field by its path, as
`twist.twist.linear.x`; a list is one column, "(0.0, 0.0)", or several, `position_0` and `position_1`. What no
column has is zero, or empty. It wants rosbags (`pip install 'robomend-client[ros1]'`), and knows the types of
ROS 1 Noetic.
"""

from __future__ import annotations

import ast
import csv
import sys
from collections.abc import Iterator, Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS1_NOETIC)
BASE, NAME = 1, 2  # of rosbags: a number or a text, and another type; the rest are lists
COLUMNS = {"sec": "secs", "nanosec": "nsecs"}
"""ROS 1 calls the parts of a time so, rosbags as ROS 2 does."""

Row = Mapping[str, str | None]


def made(kind: str, row: Row, path: str = "") -> Any:
    """Return the message that a row holds below a path."""
    fields = {
        name: _value(node, row, path + COLUMNS.get(name, name)) for name, node in STORE.fielddefs[kind][1]
    }
    return STORE.types[kind](**fields)


def _value(node: Any, row: Row, path: str) -> Any:
    shape, inside = node
    if shape == NAME:
        return made(inside, row, f"{path}.")
    if shape == BASE:
        return _plain(inside[0], row.get(path))
    (shape, kind), length = inside  # a list of that
    if shape == NAME:
        raise ValueError(f"{path}: a list of messages has no place in columns")
    given = row.get(path)
    texts = [str(item) for item in ast.literal_eval(given)] if given else list(_numbered(row, path))
    texts += [""] * (length - len(texts))  # of a list of any length it is 0
    items = [_plain(kind[0], text) for text in texts]
    return items if kind[0] == "string" else np.array(items, kind[0])


def _numbered(row: Row, path: str) -> Iterator[str]:
    for number in count():
        if not (text := row.get(f"{path}_{number}")):
            return
        yield text


def _plain(kind: str, text: str | None) -> Any:
    if kind == "string":
        return text or ""
    if kind == "bool":
        return text in ("True", "true", "1")
    return float(text or 0) if kind.startswith("float") else int(float(text or 0))


def time_ns(text: str) -> int:
    """Return seconds, as a text, in nanoseconds: a float has no place for them all."""
    seconds, _, part = text.partition(".")
    return int(seconds) * 10**9 + int(part[:9].ljust(9, "0"))


def main(arguments: Sequence[str]) -> None:
    bag, *topics = arguments
    rows = []
    with Writer(Path(bag)) as writer:
        for said in topics:
            file, _, what = said.partition("=")
            topic, _, kind = what.partition(":")
            kind = kind.replace("/", "/msg/")
            connection = writer.add_connection(topic, kind, typestore=STORE)
            with Path(file).open(newline="") as lines:
                for row in csv.DictReader(lines):
                    data = STORE.serialize_ros1(made(kind, row), kind)
                    rows.append((time_ns(row["Time"]), connection, data))
        for at_ns, connection, data in sorted(rows, key=lambda row: row[0]):
            writer.write(connection, at_ns, data)


if __name__ == "__main__":
    main(sys.argv[1:])
