"""Values out of messages of any type, by the definition that their publisher sends along.

rosbags is imported with the first message that somebody wants to look into: it takes 20 MB.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Any

from robomend_client.bridges.fields import UnreadableMessage
from robomend_client.bridges.ros1.subscription import Publisher

LONGEST_DEFINITION = 256 * 1024
MOST_TYPES = 256


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
