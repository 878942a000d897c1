"""Values out of messages of any type, by the definition that their publisher sends along.

rosbags is imported with the first message that somebody wants to look into: it takes 20 MB.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import lru_cache
from typing import Any

from robomend_client.bridges.ros1.subscription import Publisher

LONGEST_DEFINITION = 256 * 1024
MOST_TYPES = 256


class UnreadableMessage(Exception):
    """A definition or a message that cannot be read, or has no such field."""


class MessageReaders:
    """How the messages of each publisher are read; the newest MOST_TYPES definitions are kept."""

    def __init__(self) -> None:
        self._readers: OrderedDict[tuple[str, str], Callable[[bytes], Any]] = OrderedDict()

    def read(self, publisher: Publisher, body: bytes) -> Any:
        """Return the message, as an object with its fields.

        Raises:
            UnreadableMessage: the definition, or these bytes.
        """
        key = (publisher.type, publisher.definition)
        reader = self._readers.get(key)
        if reader is None:
            reader = self._readers[key] = _reader(publisher)
            if len(self._readers) > MOST_TYPES:
                self._readers.popitem(last=False)
        return reader(body)


def _reader(publisher: Publisher) -> Callable[[bytes], Any]:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    kind = publisher.type
    name = full_name(kind)
    store = get_typestore(Stores.EMPTY)  # one for each: two publishers may define one name differently
    try:
        if len(publisher.definition) > LONGEST_DEFINITION:
            raise ValueError(f"{len(publisher.definition)} characters")
        store.register(get_types_from_msg(publisher.definition, name))
        _, md5 = store.generate_msgdef(name, ros_version=1)
    except Exception as error:  # noqa: BLE001  # the text comes from anybody
        why = f"the definition of {kind} by {publisher.node} cannot be read: {error}"[:300]

        def refuse(_: bytes) -> Any:
            raise UnreadableMessage(why)

        return refuse
    told = "" if md5 == publisher.md5 else f" (its md5sum is not that of its definition, {md5})"

    def read(body: bytes) -> Any:
        try:
            return store.deserialize_ros1(body, name)
        except Exception as error:  # so do the bytes
            raise UnreadableMessage(
                f"a message of {kind} by {publisher.node} cannot be read: {error}{told}"[:300]
            ) from error

    return read


def full_name(kind: str) -> str:
    """Return rosbags' name of a ROS 1 type: `std_msgs/msg/String`."""
    package, _, name = kind.rpartition("/")
    return f"{package}/msg/{name}"


def value_at(message: Any, path: str) -> Any:
    """Return what a dotted path leads to, as numbers, texts, lists and mappings.

    Raises:
        UnreadableMessage: the message has no such field.
    """
    value = message
    for name in steps(path):
        try:
            value = value[int(name)] if name.isdigit() else getattr(value, name)
        except (AttributeError, IndexError, TypeError, KeyError):
            raise UnreadableMessage(f"no field {path}: {name!r} is not there") from None
    return plain(value)


@lru_cache(maxsize=1024)
def steps(path: str) -> tuple[str, ...]:
    """Return a path's names; those of Python's own are none of a message's."""
    return tuple("-" if name.startswith("__") else name for name in path.split("."))


def plain(value: Any) -> Any:
    """Return a value of a message without the classes of rosbags and numpy."""
    if isinstance(value, (int, float, str, bool)):
        return value
    if isinstance(value, list):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # numpy's arrays and numbers
        return value.tolist()
    if not is_dataclass(value):
        return str(value)
    names = (field.name for field in fields(value))
    return {name: plain(getattr(value, name)) for name in names if not name.startswith("__")}
