"""ROS 1 bags. Whole ones by their index; those that are cut off (a robot that died, `.bag.active`), or have a
damaged index, as a stream of records.

    #ROSBAG V2.0
    record: header length, header (name=value, …), data length, data
            op 2 message, 3 the bag, 4 index of a chunk, 5 chunk, 6 what is in a chunk, 7 connection

In a chunk are connections and messages, packed by bz2 or lz4 or not at all. After it comes its index, of each
connection one record; after all of them connections again, and what is in each chunk.
"""

from __future__ import annotations

import struct
from bz2 import BZ2Decompressor
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from rosbags.typesys.msg import normalize_msgtype

from robomend_batch.logs import lz4_cut
from robomend_batch.logs.chunk import LARGEST_CHUNK, Chunk, Chunked, Found, Part, by_place, in_order
from robomend_batch.logs.recorded import (
    DAMAGED,
    Channel,
    Message,
    Notes,
    Recording,
    Span,
    Times,
    Unreadable,
    damage_of,
    hole,
)
from robomend_client.observers.base import SECOND

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = range(2, 8)
LENGTH, STAMP, PLACE = struct.Struct("<I"), struct.Struct("<II"), struct.Struct("<Q")
ENTRY = np.dtype([("seconds", "<u4"), ("nanoseconds", "<u4"), ("offset", "<u4")])
COUNT = struct.Struct("<II")


class Cut(Exception):
    """The file ends in the middle of a record."""


def open_bag(path: Path) -> Recording:
    """Return a recording; Unreadable if nothing of it can be read."""
    try:
        return IndexedBag(path)
    except _NotClosed:
        return StreamedBag(path, "it has no index: the recorder did not close it")
    except (*DAMAGED, Cut) as error:
        return StreamedBag(
            path, "", f"its index is damaged ({damage_of(error)}): all of its messages were read"
        )


class _NotClosed(Exception):
    """A bag that has no index."""


@dataclass(frozen=True, slots=True)
class _Info:
    """A chunk, by the index."""

    place: int
    counts: Mapping[int, int]  # of messages, by connection


class IndexedBag(Chunked):
    """A bag that was closed."""

    damage = DAMAGED

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._has_checksum = False  # of the chunk that was unpacked last
        self._file = path.open("rb")
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        self._file.close()

    def _open(self) -> None:
        file = self._file
        if file.read(len(MAGIC)) != MAGIC:
            raise Unreadable("no bag of version 2.0")
        header, _, _ = _record_of(file, BAG)
        (at,) = PLACE.unpack(header["index_pos"])
        if at == 0:
            raise _NotClosed
        if header.get("encryptor"):
            raise Unreadable("it is encrypted")
        file.seek(at)
        known: dict[int, Channel] = {}
        for _ in range(LENGTH.unpack(header["conn_count"])[0]):
            connection, data, _ = _record_of(file, CONNECTION)
            _note_connection(known, connection, data)
        parts = [self._part() for _ in range(LENGTH.unpack(header["chunk_count"])[0])]
        if file.read(1):
            raise ValueError("it goes on behind its index")
        parts.sort(key=lambda part: part.chunk.place)
        self.channels = list(known.values())
        self._compare(parts, known)
        parts = [part for part in parts if part.chunk.counts]
        self._place(parts, [part in (parts[0], parts[-1]) for part in parts])

    def _part(self) -> Part:
        """Return what the index says of the next chunk."""
        info, data, _ = _record_of(self._file, CHUNK_INFO)
        (place,) = PLACE.unpack(info["chunk_pos"])
        counts = dict(COUNT.iter_unpack(data))
        if len(counts) != LENGTH.unpack(info["count"])[0]:
            raise ValueError("what is in a chunk")
        return Part(_stamp(info["start_time"]), _stamp(info["end_time"]), place, _Info(place, counts))

    def _compare(self, parts: list[Part], known: Mapping[int, Channel]) -> None:
        """Refuse connections of the index that are others in chunks that can be read."""
        found: dict[int, Channel] = {}
        left = {number for part in parts for number in part.chunk.counts}
        if not left <= known.keys():
            raise ValueError("a connection is not in its index")
        for part in parts:
            if not left.isdisjoint(part.chunk.counts):  # the first chunk of a topic declares it
                left -= part.chunk.counts.keys()
                try:
                    data = self._data(part.chunk)
                    for header, begin, end in _messages(data):
                        if header["op"] == bytes([CONNECTION]):
                            _note_connection(found, header, data[begin:end])
                except (*DAMAGED, Cut):
                    continue
        if any(known.get(number) != channel for number, channel in found.items()):
            raise ValueError("it names other topics than the chunks")

    def _channels_of(self, part: Part) -> Iterable[int]:
        return part.chunk.counts  # type: ignore[no-any-return]  # an _Info's

    def _of_part(self, part: Part, wanted: Mapping[int, bool]) -> Chunk:
        info: _Info = part.chunk
        index = self._index(info)
        data = None
        if any(wanted.get(channel) for channel in info.counts):
            data = self._data(info)
        found: Found | None
        if index is None:
            found = None
        elif data is None:
            found = (
                {channel: (*one, one[1]) for channel, one in index.items()} if _bounded(index, part) else None
            )
        else:
            found = _checked(index, data)
        if found is None:
            data = self._data(info) if data is None else data
            found = _walked(data)
            same = index is not None and all(
                channel in found and np.array_equal(found[channel][0], times_ns)
                for channel, (times_ns, _) in index.items()
            )
            if not same:
                near = _in_bounds(found, part)
                sure = self._has_checksum or (
                    index is None
                    and {channel: len(one[0]) for channel, one in near.items()} == dict(info.counts)
                )
                what = "the chunk itself was read" if sure else "and no checksum says which is right"
                self.notes.add(f"the chunk at byte {part.place} and its index disagree: {what}", bad=not sure)
                found = found if self._has_checksum else near
        return Chunk(self._near(part, found), wanted, data)

    def _stamps(self, part: Part) -> tuple[Times, Times]:
        index = self._index(part.chunk)
        if index is None or not _bounded(index, part):
            index = {channel: one[:2] for channel, one in _walked(self._data(part.chunk)).items()}
        times_ns, places = (np.concatenate([one[which] for one in index.values()]) for which in (0, 1))
        order = np.argsort(places, kind="stable")
        return times_ns[order], places[order]

    def _vouched(self, part: Part) -> bool:
        index = self._index(part.chunk)
        return index is not None and _checked(index, self._data(part.chunk)) is not None

    def _index(self, info: _Info) -> dict[int, tuple[Times, Times]] | None:
        """Return times and places by connection, in the order of places; None if it is damaged."""
        file = self._file
        file.seek(info.place)
        found: dict[int, tuple[Times, Times]] = {}
        try:
            file.seek(_length(_exactly(file, 4)), 1)
            file.seek(_length(_exactly(file, 4)), 1)
            for _ in info.counts:
                header, data, _ = _record_of(file, INDEX)
                (number,) = LENGTH.unpack(header["conn"])
                entries = np.frombuffer(data, ENTRY)
                if info.counts.get(number) != len(entries) or LENGTH.unpack(header["count"])[0] != len(
                    entries
                ):
                    return None
                times_ns = entries["seconds"].astype(np.int64) * SECOND + entries["nanoseconds"]
                places = entries["offset"].astype(np.int64)
                one = by_place(times_ns, places)
                if one is None:
                    return None
                found[number] = one
        except (*DAMAGED, Cut):
            return None
        return found if found.keys() == info.counts.keys() else None

    def _data(self, info: _Info) -> bytes:
        """Return what a chunk holds; one of DAMAGED if it cannot be unpacked."""
        self._file.seek(info.place)
        try:
            header, data, whole = _record_of(self._file, CHUNK)
        except Cut:
            raise ValueError("it is cut off") from None
        if not whole:
            raise ValueError("it is cut off")
        self._has_checksum = header["compression"] == b"bz2"
        return _whole(header, data)


def _in_bounds(found: Found, part: Part) -> Found:
    kept = {channel: (one[0] >= part.start_ns) & (one[0] <= part.end_ns) for channel, one in found.items()}
    return {
        channel: (times_ns[kept[channel]], begins[kept[channel]], ends[kept[channel]])
        for channel, (times_ns, begins, ends) in found.items()
    }


def _bounded(index: Mapping[int, tuple[Times, Times]], part: Part) -> bool:
    """Return whether the stamps of an index are in their order, and in the bounds of their chunk."""
    return all(
        in_order(times_ns) and times_ns[0] >= part.start_ns and times_ns[-1] <= part.end_ns
        for times_ns, places in index.values()
    )


def _checked(index: Mapping[int, tuple[Times, Times]], data: bytes) -> Found | None:
    """Return the messages to which an index leads; None if it is to be doubted."""
    packed = np.frombuffer(data, np.uint8)
    found = {}
    for number, (times_ns, places) in index.items():
        (length,) = LENGTH.unpack_from(data, int(places[0]))
        size = 4 + length + 4
        if not 8 < size < 1000 or places[-1] + size > len(packed) or places[0] < 0:
            return None
        heads = packed[places[:, None] + np.arange(size)]
        first = bytes(heads[0])
        header = _header(first[4:-4])
        stamp_at = first.find(b"time=") + len(b"time=")
        alike = np.ones(size, dtype=np.bool_)
        alike[stamp_at : stamp_at + STAMP.size] = alike[-4:] = False
        stamps = heads[:, stamp_at : stamp_at + STAMP.size].copy().view("<u4").astype(np.int64)
        if (
            header.get("op") != bytes([MESSAGE])
            or header.get("conn") != LENGTH.pack(number)
            or len(header.get("time", b"")) != STAMP.size
            or (heads[:, alike] != heads[0][alike]).any()
            or (stamps[:, 0] * SECOND + stamps[:, 1] != times_ns).any()
        ):
            return None
        begins = places + size
        ends = begins + heads[:, -4:].copy().view("<u4")[:, 0].astype(np.int64)
        if (ends > len(packed)).any():
            return None
        found[number] = times_ns, begins, ends
    return found


def _walked(data: bytes) -> Found:
    """Return all messages of a chunk, as it says itself; one of DAMAGED if that cannot be."""
    found: dict[int, tuple[list[int], list[int], list[int]]] = {}
    try:
        for header, begin, end in _messages(data):
            if header["op"] == bytes([MESSAGE]):
                times, begins, ends = found.setdefault(LENGTH.unpack(header["conn"])[0], ([], [], []))
                times.append(_stamp(header["time"]))
                begins.append(begin)
                ends.append(end)
    except Cut:
        raise ValueError("a record is longer than its chunk") from None
    return {
        number: (np.array(one[0], np.int64), np.array(one[1], np.int64), np.array(one[2], np.int64))
        for number, one in found.items()
    }


def _messages(data: bytes) -> Iterator[tuple[dict[str, bytes], int, int]]:
    """Yield the records of a chunk: header, and where the data begins and ends; Cut if it ends in one."""
    at, end = 0, len(data)
    while at < end:
        if at + 4 > end:
            raise Cut
        length = _length(data[at : at + 4])
        header = _header(data[at + 4 : at + 4 + length])
        at += 4 + length
        if at + 4 > end:
            raise Cut
        begin = at + 4
        at = begin + _length(data[at:begin])
        if at > end:
            raise Cut
        if header.get("op") not in (bytes([MESSAGE]), bytes([CONNECTION])):
            raise ValueError("a chunk has another record than connections and messages")
        yield header, begin, at


class StreamedBag:
    """A bag without its index. It is read twice: for what is in it, and for that."""

    by_time = False
    checked: bool | None = None

    def __init__(self, path: Path, cut: str = "", note: str = "") -> None:
        self._path = path
        self._known: dict[int, Channel] = {}
        self.cut: str | None = None
        self.notes = Notes()
        if note:
            self.notes.add(note, bad=True)
        span = Span()
        for time_ns, number, _ in self._all({}, every=True):
            if number >= 0:
                span.add(time_ns)
        bounds = span.bounds(self.notes, sure=False)
        self.start_ns: int | None = bounds and bounds[0]
        self.end_ns: int | None = bounds and bounds[1]
        self.channels = list(self._known.values())
        self._why = cut or None
        self.cut = self.cut or self._why
        if self.start_ns is None and (self.cut is not None or note):
            raise Unreadable(self.cut or note)

    def messages(self, wanted: Mapping[int, bool], from_ns: int | None = None) -> Iterator[Message]:
        with self.notes.told_before():
            yield from self._all(wanted, every=False)

    def _all(self, wanted: Mapping[int, bool], every: bool) -> Iterator[Message]:
        last_ns: int | None = None
        try:
            with self._path.open("rb") as file:
                if file.read(len(MAGIC)) != MAGIC:
                    raise Unreadable("no bag of version 2.0")
                while (record := _record(file)) is not None:
                    header, data, whole = record
                    operation = header.get("op", b"\0")[0]
                    if operation == CHUNK and whole:
                        try:
                            found = list(self._of_chunk(_whole(header, data), wanted, every))
                        except (*DAMAGED, Cut) as error:
                            self.notes.add(
                                f"the chunk before byte {file.tell()} is damaged: {damage_of(error)}",
                                bad=True,
                            )
                            if last_ns is not None:
                                yield hole(last_ns, last_ns)
                        else:
                            yield from found
                            last_ns = found[-1][0] if found else last_ns
                    elif operation == CHUNK:
                        data = _unpacked(header.get("compression", b"none"), data)
                        yield from self._of_chunk(data, wanted, every)
                    elif operation == CONNECTION and whole:
                        _note_connection(self._known, header, data)
                    elif operation not in (BAG, INDEX, CHUNK_INFO, CONNECTION):
                        raise ValueError(f"an unknown record before byte {file.tell()}")
                    if not whole:
                        raise Cut
        except Unreadable:
            raise
        except Cut:
            self.cut = "cut off in the middle of a record"
        except DAMAGED as error:
            self.cut = f"damaged: {damage_of(error)}"

    def close(self) -> None:
        """Nothing is open between readings."""

    def _of_chunk(self, data: bytes, wanted: Mapping[int, bool], every: bool) -> Iterator[Message]:
        for header, begin, end in _messages(data):
            if header["op"] == bytes([CONNECTION]):
                _note_connection(self._known, header, data[begin:end])
                continue
            (number,) = LENGTH.unpack(header["conn"])
            if number not in self._known:
                raise ValueError("a message is of a topic that is not declared")
            if every or number in wanted:
                yield _stamp(header["time"]), number, data[begin:end] if wanted.get(number) else None


def _note_connection(known: dict[int, Channel], header: Mapping[str, bytes], data: bytes) -> None:
    """Note a connection; ValueError if it was another one before."""
    number = LENGTH.unpack(header["conn"])[0]
    inner = _header(data)
    channel = Channel(
        number,
        "/".join(part for part in header["topic"].decode().split("/") if part),
        normalize_msgtype(inner["type"].decode()),
        inner["message_definition"].decode(errors="replace"),
        False,
        False,
        inner.get("callerid", b"").decode(errors="replace"),
    )
    if known.setdefault(number, channel) != channel:
        raise ValueError("it names a topic twice, and otherwise")


def _stamp(data: bytes) -> int:
    seconds, nanoseconds = STAMP.unpack(data)
    return int(seconds) * SECOND + int(nanoseconds)


def _record(file: BinaryIO) -> tuple[dict[str, bytes], bytes, bool] | None:
    """Return header and data of the next record, and whether the data is whole."""
    head = file.read(4)
    if not head:
        return None
    header = _header(_exactly(file, _length(head)))
    size = _length(_exactly(file, 4))
    data = file.read(size)
    return header, data, len(data) == size


def _record_of(file: BinaryIO, operation: int) -> tuple[dict[str, bytes], bytes, bool]:
    """Return the next record; ValueError if it is of another kind."""
    record = _record(file)
    if record is None or record[0].get("op") != bytes([operation]):
        raise ValueError(f"a record of kind {operation} is not where it should be")
    return record


def _length(data: bytes) -> int:
    if len(data) < 4:
        raise Cut
    length: int = LENGTH.unpack(data)[0]
    if length > LARGEST_CHUNK:
        raise ValueError(f"a record of {length:,} bytes: more than {LARGEST_CHUNK >> 20} MB")
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
    if at != len(data):
        raise ValueError("the header of a record")
    return found


def _whole(header: Mapping[str, bytes], data: bytes) -> bytes:
    """Return what a chunk holds; ValueError if it is not as long as it says."""
    (size,) = LENGTH.unpack(header["size"])
    if size > LARGEST_CHUNK:
        raise ValueError(
            f"it says that it holds {size:,} bytes; more than {LARGEST_CHUNK >> 20} MB are not read"
        )
    found = _unpacked(header["compression"], data, size + 1)
    if len(found) != size:
        raise ValueError(f"it holds {len(found)} bytes and not {size}")
    return found


def _unpacked(compression: bytes, data: bytes, most: int = LARGEST_CHUNK) -> bytes:
    """Return what a chunk holds, of one that is cut off as much as there is, and at most so many bytes."""
    if compression == b"none":
        return data
    if compression == b"bz2":
        return BZ2Decompressor().decompress(data, most)
    if compression == b"lz4":
        return lz4_cut.unpacked(data, most)
    raise ValueError(f"packed by {compression.decode(errors='replace')}, which is not known")
