"""Definitions: the robot's own, rosbags', and those whose hash does not fit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from robomend_client.bridges.fields import UnreadableMessage
from robomend_client.bridges.ros2.messages import MessageReaders, folders_of

MOTOR = "std_msgs/Header header\nfloat64 temperature\nmy_msgs/Part[] parts\n"
PART = "string name\nfloat32[3] currents\n"


def package(folder: Path) -> Path:
    """Return a folder of packages, with one of them."""
    (folder / "my_msgs" / "msg").mkdir(parents=True)
    (folder / "my_msgs" / "msg" / "Motor.msg").write_text(MOTOR)
    (folder / "my_msgs" / "msg" / "Part.msg").write_text(PART)
    return folder


def motor() -> tuple[bytes, str]:
    """Return a message of a robot's own type, and the hash of its definition."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(
        get_types_from_msg(MOTOR, "my_msgs/msg/Motor") | get_types_from_msg(PART, "my_msgs/msg/Part")
    )
    kinds: Any = store.types
    stamp = kinds["builtin_interfaces/msg/Time"](sec=1, nanosec=2)
    header = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="base")
    part = kinds["my_msgs/msg/Part"](name="left", currents=np.array([1.0, 2.5, 3.0], np.float32))
    message = kinds["my_msgs/msg/Motor"](header=header, temperature=39.5, parts=[part])
    body = store.serialize_cdr(message, "my_msgs/msg/Motor")
    return bytes(body), store.hash_rihs01("my_msgs/msg/Motor")


def test_a_type_of_the_robots_own_is_read_by_the_definition_in_its_package(tmp_path: Path) -> None:
    body, type_hash = motor()
    folders = folders_of({"AMENT_PREFIX_PATH": f"/nowhere:{tmp_path}"}, [])
    package(tmp_path / "share")
    for said in (type_hash, ""):
        message = MessageReaders(folders).open("my_msgs/Motor", said, body)
        assert message.at("parts.0.currents.1") == 2.5
        assert message.at("header.frame_id") == "base"
        assert message.at("temperature") == 39.5


@pytest.mark.parametrize(
    ("kind", "type_hash", "body", "why"),
    [
        ("my_msgs/Nothing", "", b"\0\1\0\0", "there is no definition of my_msgs/Nothing here"),
        ("my_msgs/Motor", "RIHS01_0", b"\0\1\0\0", "my_msgs/Motor here is not its publisher's"),
        ("my_msgs/Motor", "", b"\0\1\0\0\7", "a message of my_msgs/Motor cannot be read"),
        ("my_msgs/Broken", "", b"\0\1\0\0", "the definition of my_msgs/Broken cannot be read"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_says_why(
    kind: str, type_hash: str, body: bytes, why: str, tmp_path: Path
) -> None:
    package(tmp_path)
    (tmp_path / "my_msgs" / "msg" / "Broken.msg").write_text("float64\n=\n")
    readers = MessageReaders([tmp_path])
    for _ in range(2):
        with pytest.raises(UnreadableMessage, match=why):
            readers.open(kind, type_hash, body).at("temperature")


def test_of_the_releases_that_rosbags_knows_the_one_whose_hash_fits_is_taken() -> None:
    name = "rcl_interfaces/msg/ParameterDescriptor"  # Galactic gave it a field, in the middle
    foxy = get_typestore(Stores.ROS2_FOXY)
    message: Any = foxy.types[name](
        name="rate",
        type=2,
        description="",
        additional_constraints="",
        read_only=True,
        floating_point_range=[],
        integer_range=[],
    )
    body = bytes(foxy.serialize_cdr(message, name))
    found = MessageReaders().open("rcl_interfaces/ParameterDescriptor", foxy.hash_rihs01(name), body)
    assert found.at("read_only") is True
    assert not found.has("dynamic_typing")
