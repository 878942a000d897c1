"""Values out of messages of any type, by the definition that their publisher sends along.

rosbags is imported with the first message that somebody wants to look into.
"""

from __future__ import annotations

from collections import OrderedDict

from robomend_client.agent.ring import TopicDescription
from robomend_client.bridges.fields import UnreadableMessage
from robomend_client.bridges.opened import KnownType, OpenedMessage, undescribed
from robomend_client.bridges.ros1.subscription import Publisher

LONGEST_DEFINITION = 256 * 1024
MOST_TYPES = 256


class MessageReaders:
    """How the messages of each publisher are read; the newest MOST_TYPES definitions are kept."""

    def __init__(self) -> None:
        self._types: OrderedDict[tuple[str, str], KnownType | str] = OrderedDict()  # or why there is none

    def open(self, publisher: Publisher, body: bytes) -> OpenedMessage:
        """Return the message, to look into.

        Raises:
            UnreadableMessage: its definition cannot be read.
        """
        found = self.known(publisher)
        if isinstance(found, str):
            raise UnreadableMessage(found)
        return found.open(body)

    def known(self, publisher: Publisher) -> KnownType | str:
        """Return how the messages of a publisher are read, or why they cannot be."""
        key = (publisher.type, publisher.definition)
        found = self._types.get(key)
        if found is None:
            found = self._types[key] = _type_of(publisher)
            if len(self._types) > MOST_TYPES:
                self._types.popitem(last=False)
        return found


def described(readers: MessageReaders, publisher: Publisher) -> TopicDescription:
    """Return how the messages of a publisher are to be read elsewhere: by the definition that it sent."""
    found = readers.known(publisher)
    if isinstance(found, str):
        return undescribed(publisher.type, found, cdr=False)
    return found.described()._replace(schema=publisher.definition)


def _type_of(publisher: Publisher) -> KnownType | str:
    """Return how its messages are read, or why they cannot be."""
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
        return f"the definition of {kind} by {publisher.node} cannot be read: {error}"[:300]
    told = "" if md5 == publisher.md5 else f" (its md5sum is not that of its definition, {md5})"
    return KnownType(store, name, f"{kind} by {publisher.node}", cdr=False, hint=told)


def full_name(kind: str) -> str:
    """Return rosbags' name of a ROS 1 type: `std_msgs/msg/String`."""
    package, _, name = kind.rpartition("/")
    return f"{package}/msg/{name}"
