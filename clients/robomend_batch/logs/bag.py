"""ROS 1 bags. Whole ones by their index; cut off (a robot that died, `.bag.active`) as a stream of records.

    #ROSBAG V2.0
    record: header length, header (name=value, …), data length, data     op 5 chunk, 7 connection, 2 message

In a chunk are connections and messages, packed by bz2 or lz4 or not at all. After it comes its index,
which a stream skips.
"""

from __future__ import annotations

import struct
from bz2 import BZ2Decompressor
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import BinaryIO

from rosbags.rosbag1 import Reader, ReaderError
from rosbags.typesys.msg import normalize_msgtype

from robomend_batch.logs import lz4_cut
from robomend_batch.logs.recorded import DAMAGED, Channel, Message, Recording, Unreadable
from robomend_client.observers.base import SECOND

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, CHUNK, CONNECTION = 2, 5, 7
LARGEST = 1 << 30
LENGTH, STAMP = struct.Struct("<I"), struct.Struct("<II")

DAMAGE = (*DAMAGED, ReaderError)


class Cut(Exception):
    """The file ends in the middle of a record."""


def open_bag(path: Path) -> Recording:
    """Return a recording; Unreadable if nothing of it can be read."""
    try:
        return IndexedBag(path)
    except DAMAGE:
        return StreamedBag(path)


class IndexedBag:
    """A bag that was closed."""

    by_time = True

    def __init__(self, path: Path) -> None:
        self._reader = Reader(path)
        self._reader.open()
        self.cut: str | None = None
        some = bool(self._reader.chunk_infos)
        self.start_ns = self._reader.start_time if some else None
        self.end_ns = max(info.end_time for info in self._reader.chunk_infos) if some else None
        self.channels = [
            Channel(
                c.id,
                c.topic.lstrip("/"),
                c.msgtype,
                c.msgdef.data,
                False,
                False,
                getattr(c.ext, "callerid", None) or "",
            )
            for c in self._reader.connections
        ]

    def messages(self, wanted: Mapping[int, bool], from_ns: int | None = None) -> Iterator[Message]:
        connections = [c for c in self._reader.connections if c.id in wanted]
        if not connections:
            return
        if not any(wanted.values()):  # the index has their times
            yield from sorted(
                (entry.time, number, None)
                for number in wanted
                for entry in self._reader.indexes[number]
                if from_ns is None or entry.time >= from_ns
            )
            return
        try:
            for connection, time_ns, data in self._reader.messages(connections, from_ns):
                yield time_ns, connection.id, data if wanted[connection.id] else None
        except DAMAGE as error:
            self.cut = f"damaged: {error}"

    def close(self) -> None:
        self._reader.close()


class StreamedBag:
    """A bag without its index. It is read twice: for what is in it, and for that."""

    by_time = False

    def __init__(self, path: Path) -> None:
        self._path = path
        self._known: dict[int, Channel] = {}
        self.start_ns: int | None = None
        self.end_ns: int | None = None
        self.cut: str | None = None
        for time_ns, _, _ in self._all({}, every=True):
            self.start_ns = time_ns if self.start_ns is None else min(self.start_ns, time_ns)
            self.end_ns = time_ns if self.end_ns is None else max(self.end_ns, time_ns)
        self.channels = list(self._known.values())
        self.cut = self.cut or "it has no index: the recorder did not close it"
        if self.start_ns is None:
            raise Unreadable(self.cut)

    def messages(self, wanted: Mapping[int, bool], from_ns: int | None = None) -> Iterator[Message]:
        return self._all(wanted, every=False)

    def _all(self, wanted: Mapping[int, bool], every: bool) -> Iterator[Message]:
        try:
            with self._path.open("rb") as file:
                if file.read(len(MAGIC)) != MAGIC:
                    raise Unreadable("no bag of version 2.0")
                while (record := _record(file)) is not None:
                    header, data, whole = record
                    if header.get("op") == bytes([CHUNK]):
                        data = _unpacked(header.get("compression", b"none"), data)
                        yield from self._of_chunk(data, wanted, every)
                    elif header.get("op") == bytes([CONNECTION]) and whole:
                        self._connection(header, data)
                    if not whole:
                        raise Cut
        except Unreadable:
            raise
        except Cut:
            self.cut = "cut off in the middle of a record"
        except DAMAGED as error:
            self.cut = f"damaged: {error}"

    def close(self) -> None:
        """Nothing is open between readings."""

    def _of_chunk(self, data: bytes, wanted: Mapping[int, bool], every: bool) -> Iterator[Message]:
        at = 0
        while at + 4 <= len(data):
            (length,) = LENGTH.unpack_from(data, at)
            header = _header(data[at + 4 : at + 4 + length])
            at += 4 + length
            if at + 4 > len(data):
                raise Cut
            (size,) = LENGTH.unpack_from(data, at)
            at += 4
            if at + size > len(data):
                raise Cut
            if header["op"] == bytes([MESSAGE]):
                number = LENGTH.unpack(header["conn"])[0]
                if every or number in wanted:
                    seconds, nanoseconds = STAMP.unpack(header["time"])
                    body = data[at : at + size] if wanted.get(number) else None
                    yield seconds * SECOND + nanoseconds, number, body
            elif header["op"] == bytes([CONNECTION]):
                self._connection(header, data[at : at + size])
            at += size

    def _connection(self, header: Mapping[str, bytes], data: bytes) -> None:
        number = LENGTH.unpack(header["conn"])[0]
        if number not in self._known:
            inner = _header(data)
            self._known[number] = Channel(
                number,
                header["topic"].decode().lstrip("/"),
                normalize_msgtype(inner["type"].decode()),
                inner["message_definition"].decode(errors="replace"),
                False,
                False,
                inner.get("callerid", b"").decode(errors="replace"),
            )


def _record(file: BinaryIO) -> tuple[dict[str, bytes], bytes, bool] | None:
    """Return header and data of the next record, and whether the data is whole."""
    head = file.read(4)
    if not head:
        return None
    header = _header(_exactly(file, _length(head)))
    size = _length(_exactly(file, 4))
    data = file.read(size)
    return header, data, len(data) == size


def _length(data: bytes) -> int:
    if len(data) < 4:
        raise Cut
    length: int = LENGTH.unpack(data)[0]
    if length > LARGEST:
        raise ValueError(f"a record of {length} bytes")
    return length


def _exactly(file: BinaryIO, size: int) -> bytes:
    data = file.read(size)
    if len(data) < size:
        raise Cut
    return data


def _header(data: bytes) -> dict[str, bytes]:
    found = {}
    at = 0
    while at + 4 <= len(data):
        (length,) = LENGTH.unpack_from(data, at)
        name, _, value = data[at + 4 : at + 4 + length].partition(b"=")
        found[name.decode("ascii", errors="replace")] = value
        at += 4 + length
    return found


def _unpacked(compression: bytes, data: bytes) -> bytes:
    """Return what a chunk holds, of one that is cut off as much as there is."""
    if compression == b"none":
        return data
    if compression == b"bz2":
        return BZ2Decompressor().decompress(data)
    if compression == b"lz4":
        return lz4_cut.unpacked(data)
    raise ValueError(f"packed by {compression.decode(errors='replace')}, which is not known")
