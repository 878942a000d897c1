"""The message on `ros_discovery_info`: the nodes of a participant, and the readers and writers they have.

A participant's id (Gid) has 16 bytes, up to Humble 24 of which the last 8 are 0: the length says which.
Source: rmw_dds_common/msg/ParticipantEntitiesInfo.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from robomend_client.bridges.ros2.cdr import BadCdr, CdrReader, CdrWriter

TOPIC = "ros_discovery_info"
TYPE = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"
GID = 16
OLD_GID = 24


@dataclass(frozen=True)
class NodeEntities:
    """A node, and the keys of its readers and writers."""

    name: str  # whole: /sensors/laser
    readers: tuple[bytes, ...] = ()
    writers: tuple[bytes, ...] = ()


@dataclass(frozen=True)
class Entities:
    """The nodes of one participant."""

    participant: bytes
    nodes: tuple[NodeEntities, ...]
    gid_size: int = GID


def decode(data: bytes) -> Entities:
    """Return what a message says.

    Raises:
        BadCdr: it is none.
    """
    for size in (GID, OLD_GID):
        try:
            return _decode(data, size)
        except BadCdr as error:
            why = error
    raise why


def _decode(data: bytes, size: int) -> Entities:
    reader = CdrReader(data)
    participant = reader.raw(size)[:GID]
    nodes = []
    for _ in range(reader.length()):
        namespace, name = reader.text(), reader.text()
        readers = tuple(reader.raw(size)[:GID] for _ in range(reader.length()))
        writers = tuple(reader.raw(size)[:GID] for _ in range(reader.length()))
        nodes.append(NodeEntities(f"{namespace.rstrip('/')}/{name}", readers, writers))
    if reader.rest > 3:  # the end may be aligned
        raise BadCdr(f"{reader.rest} bytes too many")
    return Entities(participant, tuple(nodes), size)


def encode(found: Entities) -> bytes:
    """Return the message that says so."""
    writer = CdrWriter()

    def gid(key: bytes) -> None:
        writer.raw(key.ljust(found.gid_size, b"\0"))

    def gids(keys: Iterable[bytes]) -> None:
        keys = tuple(keys)
        writer.u32(len(keys))
        for key in keys:
            gid(key)

    gid(found.participant)
    writer.u32(len(found.nodes))
    for node in found.nodes:
        namespace, _, name = node.name.rpartition("/")
        writer.text(namespace or "/")
        writer.text(name)
        gids(node.readers)
        gids(node.writers)
    return writer.message()
