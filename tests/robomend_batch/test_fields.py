"""A field that is unpacked by itself is the field of the whole message: of every type, in both encodings."""

from __future__ import annotations

import random
import struct
from functools import partial
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from robomend_batch.logs.fields import compile_column, compile_field
from robomend_client.bridges.fields import MissingField, value_at
from robomend_client.bridges.unpacking import EMPTY, NoField, unpacker

STORES = {"ros1": get_typestore(Stores.ROS1_NOETIC), "ros2": get_typestore(Stores.ROS2_HUMBLE)}
PACKAGES = ("std_msgs", "geometry_msgs", "sensor_msgs", "nav_msgs", "diagnostic_msgs")
MOST_PATHS = 40


def made(store: Any, description: Any, chance: random.Random, depth: int = 0) -> Any:
    """Return a random value of a type."""
    kind, detail = description
    if kind == Nodetype.NAME:
        fields = dict(store.fielddefs[detail][1])
        return store.types[detail](
            **{name: made(store, inner, chance, depth + 1) for name, inner in fields.items()}
        )
    if kind == Nodetype.BASE:
        name = detail[0]
        if name == "string":
            return "x" * chance.randrange(9)
        if name == "bool":
            return chance.random() < 0.5
        return chance.uniform(-9, 9) if name.startswith("float") else chance.randrange(100)
    (inner_kind, inner), count = detail
    length = count if kind == Nodetype.ARRAY else chance.randrange(4)
    items = [made(store, (inner_kind, inner), chance, depth + 1) for _ in range(length)]
    if inner_kind == Nodetype.BASE and inner[0] != "string":
        name = {"bool": "bool", "byte": "uint8", "char": "uint8"}.get(inner[0], inner[0])
        return np.array(items, dtype=name)
    return items


def paths(store: Any, type_name: str, before: str = "") -> list[str]:
    """Return the paths to single values."""
    found = []
    for name, (kind, detail) in store.fielddefs[type_name][1]:
        if name == EMPTY:
            continue
        if kind == Nodetype.NAME:
            found += paths(store, detail, f"{before}{name}.")
        elif kind == Nodetype.BASE:
            found.append(f"{before}{name}")
        elif detail[0][0] == Nodetype.BASE:
            found += [f"{before}{name}.{place}" for place in (0, 1)][: detail[1] or 2]
        else:
            inner = paths(store, detail[0][1])
            found += [f"{before}{name}.0.{path}" for path in inner[:2]]
    return found


@pytest.mark.parametrize("encoding", STORES)
@pytest.mark.parametrize("package", PACKAGES)
def test_a_field_alone_is_the_field_of_the_whole(package: str, encoding: str) -> None:
    store = STORES[encoding]
    cdr = encoding == "ros2"
    serialize = store.serialize_cdr if cdr else store.serialize_ros1
    deserialize = store.deserialize_cdr if cdr else store.deserialize_ros1
    chance = random.Random(package)
    compared = 0
    for name in [name for name in store.fielddefs if name.startswith(f"{package}/msg/")]:
        whole_of = partial(deserialize, typename=name)
        extracts = {
            path: compile_field(store.fielddefs, name, path, cdr=cdr, whole=whole_of)
            for path in paths(store, name)[:MOST_PATHS]
        }
        for _ in range(2):
            data = bytes(serialize(made(store, (Nodetype.NAME, name), chance), name))
            whole = deserialize(data, name)
            for path, extract in extracts.items():
                try:
                    expected = value_at(whole, path)
                except MissingField:
                    with pytest.raises(MissingField):
                        extract(data)
                    continue
                assert extract(data) == expected, f"{name} {path}"
                compared += 1
    assert compared


@pytest.mark.parametrize("encoding", STORES)
@pytest.mark.parametrize("package", PACKAGES)
def test_a_field_of_many_messages_at_once_is_that_of_each(package: str, encoding: str) -> None:
    store = STORES[encoding]
    cdr = encoding == "ros2"
    serialize = store.serialize_cdr if cdr else store.serialize_ros1
    chance = random.Random(package)
    compared = 0
    for name in [name for name in store.fielddefs if name.startswith(f"{package}/msg/")]:
        messages = [
            bytes(serialize(made(store, (Nodetype.NAME, name), chance), name))
            + b"?" * (cdr and chance.randrange(3))
            for _ in range(4)
        ]
        lengths = np.array([len(message) for message in messages])
        ends = 7 + np.cumsum(lengths)
        data = np.frombuffer(b"." * 7 + b"".join(messages), np.uint8)
        for path in paths(store, name)[:MOST_PATHS]:
            column = compile_column(store.fielddefs, name, path, cdr=cdr)
            alone = unpacker(store.fielddefs, name, path, cdr=cdr)
            if column is None or alone is None:
                continue
            found = column(data, ends - lengths, ends)
            assert found is not None
            assert found.tolist() == [alone(message) for message in messages], f"{name} {path}"
            compared += 1
            cut = ends - (lengths * (chance.random() > 0.5))  # of some messages nothing is there
            assert (cut == ends).all() or column(data, ends - lengths, cut) is None
            assert column(data, ends - lengths, ends + 4) is None  # longer than the type
    assert compared or package == "diagnostic_msgs"  # whose messages must be unpacked as a whole


@pytest.mark.parametrize("encoding", STORES)
def test_a_message_that_is_longer_or_shorter_than_its_type_is_refused_where_that_is_wanted(
    encoding: str,
) -> None:
    store = STORES[encoding]
    cdr = encoding == "ros2"
    serialize = store.serialize_cdr if cdr else store.serialize_ros1
    deserialize = store.deserialize_cdr if cdr else store.deserialize_ros1
    chance = random.Random(3)
    for name, path in (
        ("std_msgs/msg/Float64", "data"),
        ("std_msgs/msg/String", "data"),
        ("sensor_msgs/msg/Imu", "angular_velocity_covariance.4"),
        ("sensor_msgs/msg/Imu", "header.frame_id"),
        ("sensor_msgs/msg/LaserScan", "range_max"),
        ("nav_msgs/msg/Odometry", "twist.twist.angular.z"),
    ):
        unpack = unpacker(store.fielddefs, name, path, cdr=cdr, exact=True)
        assert unpack is not None
        for _ in range(20):
            data = bytes(serialize(made(store, (Nodetype.NAME, name), chance), name))
            padded = 3 if cdr else 0
            value = value_at(deserialize(data, name), path)
            assert unpack(data) == unpack(data + bytes(padded)) == value
            for other in (data + bytes(padded + 1), data[:-4], data[: len(data) // 2], data[:3], b""):
                with pytest.raises((ValueError, struct.error, IndexError)):
                    unpack(other)
            if cdr:
                with pytest.raises(ValueError, match="no plain CDR"):
                    unpack(b"\0\3" + data[2:])


@pytest.mark.parametrize("cdr", [True, False])
def test_a_message_is_looked_at_anew_where_its_texts_are_others_than_those_before(cdr: bool) -> None:
    store, name = STORES["ros2" if cdr else "ros1"], "nav_msgs/msg/Odometry"
    message = made(store, (Nodetype.NAME, name), random.Random(1))
    read = [
        compile_field(store.fielddefs, name, path, cdr=cdr, whole=lambda data: None)
        for path in ("pose.pose.position.x", "twist.twist.angular.z")
    ]
    for frame, child in (("a", "bcdefghijk"), ("abcdefghij", "k"), ("abcdefghij", "l")):
        message.header.frame_id, message.child_frame_id = frame, child
        data = bytes(store.serialize_cdr(message, name) if cdr else store.serialize_ros1(message, name))
        assert [one(data) for one in read] == [message.pose.pose.position.x, message.twist.twist.angular.z]
        at = 12  # of the length of its first text
        for one in read:
            with pytest.raises((ValueError, struct.error, IndexError)):
                one(data[:at] + bytes([data[at] ^ 64]) + data[at + 1 :])


def test_big_endian_messages_are_read_too() -> None:
    store = STORES["ros2"]
    message = made(store, (Nodetype.NAME, "sensor_msgs/msg/Imu"), random.Random(1))
    extract = compile_field(
        store.fielddefs, "sensor_msgs/msg/Imu", "angular_velocity.z", cdr=True, whole=lambda data: None
    )
    data = bytes(store.serialize_cdr(message, "sensor_msgs/msg/Imu", little_endian=False))
    assert extract(data) == message.angular_velocity.z


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        ("angular_velocity", "more than one value"),
        ("angular_velocity.w", "has x, y, z"),
        ("orientation_covariance.x", r"'x' is in a list, write \[0\], \[-1\] or \[key=value\] before it"),
        ("header[0]", "'0' is not there"),
        ("orientation_covariance[x=1]", "elements that are no messages have no keys, write"),
        ("header.stamp[", r"is no path at .*: write field.field, field\[0\]"),
        ("header.stamp.sec.x", "'x' is not there"),
    ],
)
def test_a_field_that_is_not_there_is_named(path: str, reason: str) -> None:
    with pytest.raises(NoField, match=reason):
        compile_field(
            STORES["ros2"].fielddefs, "sensor_msgs/msg/Imu", path, cdr=True, whole=lambda data: None
        )


def statuses(store: Any, count: int, cdr: bool) -> bytes:
    """Return a list of goals as an action server publishes it: the n-th has the id and the status n."""
    t = store.types
    stamp = t["builtin_interfaces/msg/Time"](7, 8)
    header = t["std_msgs/msg/Header"]
    if cdr:
        made = [
            t["action_msgs/msg/GoalStatus"](
                t["action_msgs/msg/GoalInfo"](
                    t["unique_identifier_msgs/msg/UUID"](np.full(16, n % 256, np.uint8)), stamp
                ),
                n % 7,
            )
            for n in range(count)
        ]
        kind = "action_msgs/msg/GoalStatusArray"
        return bytes(store.serialize_cdr(t[kind](made), kind))
    made = [
        t["actionlib_msgs/msg/GoalStatus"](
            t["actionlib_msgs/msg/GoalID"](stamp, f"g{n}"), n % 10, "x" * (n % 5)
        )
        for n in range(count)
    ]
    kind = "actionlib_msgs/msg/GoalStatusArray"
    return bytes(store.serialize_ros1(t[kind](header(0, stamp, "f"), made), kind))


@pytest.mark.parametrize("encoding", STORES)
@pytest.mark.parametrize("count", [1, 3, 10_000])
def test_elements_of_a_list_are_those_from_its_end_or_those_that_a_key_names(
    encoding: str, count: int
) -> None:
    store, cdr = STORES[encoding], encoding == "ros2"
    kind = "action_msgs/msg/GoalStatusArray" if cdr else "actionlib_msgs/msg/GoalStatusArray"
    data = statuses(store, count, cdr)
    key = f"goal_info.goal_id={'00' * 16}" if cdr else "goal_id=g0"

    def read(path: str) -> Any:
        extract = unpacker(store.fielddefs, kind, path, cdr=cdr, exact=True)
        assert extract is not None
        return extract(data)

    most = 7 if cdr else 10
    last = read("status_list[-1]")
    assert last["status"] == read("status_list[-1].status") == (count - 1) % most
    assert last["goal_info" if cdr else "goal_id"]["stamp"] == {"sec": 7, "nanosec": 8}
    assert read(f"status_list[{key}].status") == read("status_list.0.status") == 0
    assert [one["status"] for one in read("status_list[-2:]")] == [n % most for n in range(count)][-2:]
    assert read("status_list[-64:].status") == [n % most for n in range(count)][-64:]
    assert read("status_list[0].status,status_list[-1].status") == {
        "status_list[0].status": 0, "status_list[-1].status": (count - 1) % most,
    }  # fmt: skip
    for path, why in (
        (f"status_list[{count}].status", f"the list has {count} elements"),
        ("status_list[status=99].status", r"no element has \[status=99\]"),
    ):
        with pytest.raises(MissingField, match=why):
            read(path)
    with pytest.raises((ValueError, struct.error)):
        unpacker(store.fielddefs, kind, "status_list[-1].status", cdr=cdr)(data[:-8])  # type: ignore[misc]  # it is there, as the type is known
    with pytest.raises(NoField, match=r"has .*status"):
        read("status_list[stats=1].status")


def test_a_list_that_says_to_be_longer_than_its_message_is_refused_at_once() -> None:
    extract = unpacker(
        STORES["ros2"].fielddefs, "action_msgs/msg/GoalStatusArray", "status_list[-1].status", cdr=True
    )
    assert extract is not None
    with pytest.raises(ValueError, match="a list of 4294967295 elements"):
        extract(b"\0\1\0\0\xff\xff\xff\xff")
