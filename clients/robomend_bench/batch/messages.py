"""The messages of a ROS 1 recording, read whole, changed in a field, and written as a recording again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosbags.rosbag1 import Reader, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from robomend.errors import BackendError


@dataclass(frozen=True, slots=True)
class Message:
    """A message of a recording."""

    time_ns: int
    connection: Any
    data: bytes


def read(recording: Path) -> list[Message]:
    """Return the messages of a recording, in the order of time; BackendError if it cannot be read."""
    try:
        with Reader(recording) as reader:
            found = [Message(time_ns, of, bytes(data)) for of, time_ns, data in reader.messages()]
    except Exception as error:  # rosbags raises whatever of damaged files
        raise BackendError(f"cannot be read: {error}") from error
    if len(found) < 2:
        raise BackendError("there are no messages in it")
    return found


def write(file: Path, messages: Sequence[Message]) -> Path:
    """Write messages as a recording, each with its publisher."""
    with Writer(file) as writer:
        ours: dict[int, Any] = {}
        for message in messages:
            theirs = message.connection
            if theirs.id not in ours:
                ours[theirs.id] = writer.add_connection(
                    theirs.topic,
                    theirs.msgtype,
                    msgdef=theirs.msgdef.data,
                    md5sum=theirs.digest,
                    callerid=theirs.ext.callerid,
                )
            writer.write(ours[theirs.id], message.time_ns, message.data)
    return file


class Change:
    """A field of messages, read and replaced."""

    def __init__(self, connection: Any, path: str) -> None:
        self._type = connection.msgtype
        self._store = types_of(connection)
        *self._within, self._name = path.split(".")

    def value(self, data: bytes) -> float:
        """Return the field of a message."""
        return float(getattr(self._holder(self._store.deserialize_ros1(data, self._type)), self._name))

    def put(self, data: bytes, value: float) -> bytes:
        """Return the message with another value."""
        message = self._store.deserialize_ros1(data, self._type)
        setattr(self._holder(message), self._name, value)
        return bytes(self._store.serialize_ros1(message, self._type))

    def _holder(self, message: Any) -> Any:
        for name in self._within:
            message = getattr(message, name)
        return message


_STORES: dict[str, Any] = {}


def types_of(connection: Any) -> Any:
    """Return a typestore that knows a connection's type; rosbags raises whatever if it cannot be parsed."""
    key = f"{connection.msgtype} {connection.digest}"
    if key not in _STORES:
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
        _STORES[key] = store
    return _STORES[key]
