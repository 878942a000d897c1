"""Messages whose definition is known: of one, the fields that somebody wants.

field ──► unpacked by itself (unpacking.py), whenever its type allows it
     └──► out of the whole message, which rosbags makes once: that loads numpy, 12 MB
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from robomend_client.agent.ring import TopicDescription
from robomend_client.bridges.fields import UnreadableMessage, as_text, value_at

Unpack = Callable[[bytes], Any]

MOST_PATHS = 1024


def undescribed(name: str, why: str, *, cdr: bool) -> TopicDescription:
    """Return how messages are recorded of whose type there is no definition."""

    def text(data: bytes, most: int) -> str:
        raise UnreadableMessage(why)

    return TopicDescription(name, "", "ros2msg" if cdr else "ros1msg", "cdr" if cdr else "ros1", text)


class KnownType:
    """How the messages of one definition are read."""

    def __init__(self, store: Any, name: str, called: str, *, cdr: bool, hint: str = "") -> None:
        """
        Args:
            store: rosbags' typestore that has the definition.
            name: the type's in there.
            called: what a complaint calls it.
            cdr: ROS 2's encoding, else ROS 1's.
            hint: what a complaint ends with.
        """
        self._store = store
        self._name = name
        self._called = called
        self._cdr = cdr
        self._hint = hint
        self._unpack: dict[str, Unpack | None] = {}
        self._described: TopicDescription | None = None

    def open(self, data: bytes) -> OpenedMessage:
        return OpenedMessage(self, data)

    def described(self) -> TopicDescription:
        """Return how these messages are to be read elsewhere, and as text."""
        if self._described is None:
            definition, _ = self._store.generate_msgdef(self._name, ros_version=2 if self._cdr else 1)
            self._described = TopicDescription(
                self._name if self._cdr else self._name.replace("/msg/", "/"),
                definition,
                "ros2msg" if self._cdr else "ros1msg",
                "cdr" if self._cdr else "ros1",
                lambda data, most: as_text(self.whole(data), most),
            )
        return self._described

    def has(self, field: str) -> bool:
        """Return whether messages have this field, at the top."""
        return any(name == field for name, _ in self._store.fielddefs[self._name][1])

    def field(self, path: str, data: bytes) -> tuple[Any, bool]:
        """Return a field that can be unpacked by itself, and whether it can be.

        Raises:
            MissingField: a list of the message is too short, or has no such element.
            UnreadableMessage: these bytes are no such message.
        """
        if path not in self._unpack and len(self._unpack) < MOST_PATHS:
            self._unpack[path] = self._compiled(path)
        unpack = self._unpack.get(path)
        if unpack is None:
            return None, False
        try:
            return unpack(data), True
        except (ValueError, struct.error, IndexError) as error:  # the bytes come from anybody
            raise self._unreadable(error) from error

    def whole(self, data: bytes) -> Any:
        """Return the message, as an object with its fields.

        Raises:
            UnreadableMessage: these bytes are none.
        """
        read = self._store.deserialize_cdr if self._cdr else self._store.deserialize_ros1
        try:
            return read(data, self._name)
        except Exception as error:  # so do these
            raise self._unreadable(error) from error

    def _compiled(self, path: str) -> Unpack | None:
        from robomend_client.bridges.unpacking import NoField, unpacker

        try:
            return unpacker(self._store.fielddefs, self._name, path, cdr=self._cdr, exact=True)
        except NoField:
            return None  # more than one value, or none: the whole message says which

    def _unreadable(self, error: Exception) -> UnreadableMessage:
        kind = f"a message of {self._called} cannot be read"
        return UnreadableMessage(kind, f"{error}{self._hint}"[:200])


class OpenedMessage:
    """One message."""

    def __init__(self, kind: KnownType, data: bytes) -> None:
        self.has = kind.has
        self._kind = kind
        self._data = data
        self._whole: Any = None

    def at(self, path: str) -> Any:
        """Return what a path (paths.py) leads to, as numbers, texts, lists and mappings.

        Raises:
            MissingField: there is no such field.
            UnreadableMessage: this is no message of its type.
        """
        value, alone = self._kind.field(path, self._data)
        if alone:
            return value
        return value_at(self.whole(), path)

    def whole(self) -> Any:
        """Return all of it, as an object with its fields.

        Raises:
            UnreadableMessage: this is no message of its type.
        """
        if self._whole is None:
            self._whole = self._kind.whole(self._data)
        return self._whole
