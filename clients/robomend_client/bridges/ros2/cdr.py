"""CDR, version 1, as DDS has it on the wire: what little of it the bridge itself reads and writes.

    | 0x00 | 0x01: little endian | options, 2 bytes | values, each aligned to its own size |

Messages of any other type are read by what rosbags knows of them (messages.py); this spares robots that need
none its memory.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass

HEADER = b"\x00\x01\x00\x00"
LONGEST = 1_000_000
"""Members of a sequence."""


class BadCdr(ValueError):
    """These bytes are no such value."""


class CdrReader:
    """Takes values off the front of a message."""

    def __init__(self, data: bytes) -> None:
        if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
            raise BadCdr(f"no plain CDR: {data[:4].hex(' ')}")
        self._data = data
        self._at = 4
        self._u32 = struct.Struct("<I" if data[1] else ">I")

    def u32(self) -> int:
        self._at += -self._at % 4  # the header's four bytes do not disturb it
        (value,) = self._u32.unpack(self._take(4))
        return int(value)

    def raw(self, length: int) -> bytes:
        return self._take(length)

    def text(self) -> str:
        return self._take(self.u32()).rstrip(b"\0").decode(errors="replace")

    def length(self) -> int:
        """Return how many members a sequence has."""
        found = self.u32()
        if found > min(LONGEST, len(self._data)):
            raise BadCdr(f"a sequence of {found} in {len(self._data)} bytes")
        return found

    @property
    def rest(self) -> int:
        """Bytes that were not taken yet."""
        return len(self._data) - self._at

    def _take(self, length: int) -> bytes:
        end = self._at + length
        if end > len(self._data):
            raise BadCdr(f"{length} bytes at {self._at} of {len(self._data)}")
        found = self._data[self._at : end]
        self._at = end
        return found


class CdrWriter:
    """Puts values one after another."""

    def __init__(self) -> None:
        self._data = bytearray(HEADER)

    def u8(self, value: int) -> None:
        self._data.append(value)

    def u32(self, value: int) -> None:
        self._data += bytes(-len(self._data) % 4)
        self._data += struct.pack("<I", value)

    def raw(self, value: bytes) -> None:
        self._data += value

    def text(self, value: str) -> None:
        data = value.replace("\0", "").encode(errors="replace") + b"\0"
        self.u32(len(data))
        self._data += data

    def message(self) -> bytes:
        return bytes(self._data)


# --- the message on `ros_discovery_info`: the nodes of a participant, and the readers and writers they have.
#
# A participant's id (Gid) has 16 bytes, up to Humble 24 of which the last 8 are 0: the length says which.
# Source: rmw_dds_common/msg/ParticipantEntitiesInfo.

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
