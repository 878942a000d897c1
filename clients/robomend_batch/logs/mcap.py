"""ROS 2 recordings in MCAP.

With an index, only what is wanted is touched: of topics whose stamps suffice the index alone, so that most of
the file is never read; of the others the chunks that hold them. Without one, with a damaged one, or cut off,
the file is read as a stream, up to where it ends, and held against what its summary says of it.

    record: operation, u8 | length, u64 | content
    chunk:  start, end, size, u64 each | crc, u32 | compression | length, u64 | records
"""

from __future__ import annotations

import struct
from binascii import crc32
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Channel as ChannelRecord
from mcap.records import Schema, Statistics
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.storage_mcap import ChunkInfo, McapReader

from robomend_batch.logs.chunk import LARGEST_CHUNK, Chunk, Chunked, Found, Part, by_place, gathered, in_order
from robomend_batch.logs.mcap_chunk import HEAD_BYTES, ZstdError, has_checksum, left_of_chunk, unpacked
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

INDEX = np.dtype([("time", "<u8"), ("offset", "<u8")])
INDEX_HEAD = struct.Struct("<BQHI")
RECORD = struct.Struct("<BQ")
CHUNK_HEAD = struct.Struct("<QQQII")
MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Before the data: channel, sequence, log time, publish time."""

HEAD = np.dtype(
    [("operation", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("time", "<u8")]
)
"""Of a message, with its record's."""

MAGIC = b"\x89MCAP0\r\n"
FOOTER = struct.Struct("<QQI")
END_BYTES = RECORD.size + FOOTER.size + len(MAGIC)

HEADER, FOOT, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = range(1, 8)
CHUNK_INDEX, ATTACHMENT, STATISTICS, METADATA, DATA_END = 8, 9, 11, 12, 15
CHUNK_PLACE = struct.Struct("<QQQ")
"""Of a chunk's index: first and last time, and where it is."""

LATEST = 1 << 62

DAMAGE = (*DAMAGED, ReaderError, McapError, ZstdError)


def open_mcap(path: Path) -> Recording:
    """Return a recording; Unreadable if nothing of it can be read."""
    try:
        return IndexedMcap(path)
    except DAMAGE:
        return StreamedMcap(path)


class IndexedMcap(Chunked):
    """A whole file with an index of its chunks."""

    damage = DAMAGE

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._reader = McapReader(path)
        self._file = path.open("rb")
        try:
            self._checked = _is_checked(self._file)
            self._reader.open()
            self.channels = [_channel(connection) for connection in self._reader.connections]
            statistics = self._reader.statistics
            if statistics is not None and statistics.message_count:
                chunks = sorted(self._reader.chunks, key=lambda chunk: chunk.chunk_start_offset)
                self._refuse_what_has_no_index(chunks)
                doubtful = [not self._checked and not self._head_agrees(chunk) for chunk in chunks]
                if not self._checked:
                    self._compare(chunks)
                parts = [
                    Part(
                        _time(chunk.message_start_time),
                        _time(chunk.message_end_time),
                        chunk.chunk_start_offset,
                        chunk,
                    )
                    for chunk in chunks
                ]
                self._place(parts, doubtful)
        except BaseException:
            self.close()
            raise

    @property
    def checked(self) -> bool | None:
        return (self._checked and all(self._head(part.chunk)[1] for part in self._parts)) or None

    def close(self) -> None:
        self._file.close()
        if self._reader.bio is not None:
            self._reader.close()

    def _refuse_what_has_no_index(self, chunks: list[ChunkInfo]) -> None:
        known = {channel.number for channel in self.channels}
        if not chunks or not all(
            chunk.message_index_length
            and chunk.message_index_offsets
            and known.issuperset(chunk.message_index_offsets)
            for chunk in chunks
        ):
            raise ReaderError("not all of its messages are in chunks with an index")

    def _head_agrees(self, chunk: ChunkInfo) -> bool:
        """Return whether a chunk says of itself what a summary without a checksum says of it."""
        return self._head(chunk)[0] == (chunk.message_start_time, chunk.message_end_time)

    def _head(self, chunk: ChunkInfo) -> tuple[tuple[int, int], int]:
        """Return between which times a chunk says that it is, and its checksum."""
        self._file.seek(chunk.chunk_start_offset + RECORD.size)
        start, end, _, crc, _ = CHUNK_HEAD.unpack(self._file.read(CHUNK_HEAD.size))
        return (start, end), crc

    def _compare(self, chunks: list[ChunkInfo]) -> None:
        """Hold a summary without a checksum against the data; ReaderError if they disagree."""
        statistics = self._reader.statistics
        assert statistics is not None
        behind = [
            chunk.chunk_start_offset + chunk.chunk_length + chunk.message_index_length for chunk in chunks
        ]
        if (
            statistics.chunk_count != len(chunks)
            or statistics.message_count != sum(sum(chunk.channel_count.values()) for chunk in chunks)
            or [chunk.chunk_start_offset for chunk in chunks[1:]] != behind[:-1]
        ):
            raise ReaderError("its index does not have all chunks")
        left = {number for chunk in chunks for number in chunk.message_index_offsets}
        schemas: dict[int, Schema] = {}
        found: dict[int, Channel] = {}
        for chunk in chunks:
            if not left.isdisjoint(chunk.message_index_offsets):  # the first chunk of a topic declares it
                left -= chunk.message_index_offsets.keys()
                for operation, content in _records(self._data(chunk)):
                    if operation != MESSAGE:
                        _declared(operation, content, schemas, found)
        if any(found.get(channel.number, channel) != channel for channel in self.channels):
            raise ReaderError("its summary names other topics than its chunks")

    def _channels_of(self, part: Part) -> Iterable[int]:
        return part.chunk.message_index_offsets  # type: ignore[no-any-return]  # a ChunkInfo's

    def _of_part(self, part: Part, wanted: Mapping[int, bool]) -> Chunk:
        chunk: ChunkInfo = part.chunk
        index = self._index(chunk, wanted)
        data = None
        if any(wanted.get(channel) for channel in chunk.message_index_offsets):
            data = self._data(chunk)
        found = None if index is None else _checked(index, chunk, data, wanted)
        if found is None:
            data = self._data(chunk) if data is None else data
            found = _walked(data)
            if index is None or any(
                channel not in found or not np.array_equal(found[channel][0], times_ns)
                for channel, (times_ns, _) in index.items()
            ):
                unsure = not self._head(chunk)[1]
                what = "and no checksum says which is right" if unsure else "the chunk itself was read"
                self.notes.add(f"the chunk at byte {part.place} and its index disagree: {what}", bad=unsure)
        return Chunk(self._near(part, found), wanted, data)

    def _stamps(self, part: Part) -> tuple[Times, Times]:
        chunk: ChunkInfo = part.chunk
        index = self._index(chunk, chunk.message_index_offsets)
        if index is None or _checked(index, chunk, None, {}) is None:
            index = {
                channel: (times_ns, begins)
                for channel, (times_ns, begins, _) in _walked(self._data(chunk)).items()
            }
        times_ns, places = (
            np.concatenate([one[which] for one in index.values()] or [np.zeros(0, np.int64)])
            for which in (0, 1)
        )
        order = np.argsort(places, kind="stable")
        return times_ns[order], places[order]

    def _vouched(self, part: Part) -> bool:
        wanted = dict.fromkeys(part.chunk.message_index_offsets, True)
        index = self._index(part.chunk, wanted)
        return index is not None and _checked(index, part.chunk, self._data(part.chunk), wanted) is not None

    def _index(self, chunk: ChunkInfo, wanted: Iterable[int]) -> dict[int, tuple[Times, Times]] | None:
        """Return times and places by channel, in the order of places; None if its records are damaged."""
        base = chunk.chunk_start_offset + chunk.chunk_length
        self._file.seek(base)
        block = self._file.read(chunk.message_index_length)
        found: dict[int, tuple[Times, Times]] = {}
        at, records = 0, 0
        while at + INDEX_HEAD.size <= len(block):
            operation, length, channel, size = INDEX_HEAD.unpack_from(block, at)
            if (
                operation != MESSAGE_INDEX
                or length != size + 6
                or size % INDEX.itemsize
                or at + RECORD.size + length > len(block)
                or chunk.message_index_offsets.get(channel) != base + at
            ):
                return None
            if channel in wanted:
                index = np.frombuffer(block, INDEX, size // INDEX.itemsize, at + INDEX_HEAD.size)
                times_ns, places = index["time"].astype(np.int64), index["offset"].astype(np.int64)
                one = by_place(times_ns, places)
                if one is None:
                    return None
                found[channel] = one
            at += RECORD.size + length
            records += 1
        return found if at == len(block) and records == len(chunk.message_index_offsets) else None

    def _data(self, chunk: ChunkInfo) -> bytes:
        if chunk.uncompressed_size > LARGEST_CHUNK:
            raise ReaderError(_too_large(chunk.uncompressed_size))
        _, crc = self._head(chunk)
        self._file.seek(chunk.chunk_start_offset + RECORD.size + 40 + len(chunk.compression))
        packed = self._file.read(chunk.compressed_size)
        return _unpacked(packed, chunk.compression, chunk.uncompressed_size, crc)


@dataclass
class _Summary:
    """What a file says of itself at its end."""

    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    counts: Mapping[int, int] | None = None  # of messages, by channel
    places: set[int] = field(default_factory=set)  # of chunks
    damaged: bool = False


class StreamedMcap:
    """A file without an index, or without its end. It is read twice: for what is in it, and for that."""

    by_time = False

    def __init__(self, path: Path) -> None:
        self._path = path
        self.cut: str | None = None
        self.notes = Notes()
        self.checked: bool | None = True  # False: a chunk is compressed, and nothing vouches for it
        self._known: dict[int, Channel] = {}
        self._places: set[int] = set()  # of chunks
        counts: Counter[int] = Counter()
        span = Span()
        summary = _Summary({}, {})
        for time_ns, number, _ in self._read({}, every=True, summary=summary):
            if number >= 0:
                counts[number] += 1
                span.add(time_ns)
        self.channels = list(self._known.values())
        bounds = span.bounds(self.notes, sure=self.checked is True)
        self.start_ns: int | None = bounds and bounds[0]
        self.end_ns: int | None = bounds and bounds[1]
        if self.start_ns is None and self.cut is not None:
            raise Unreadable(self.cut)
        if self.cut is None:
            self._compare(summary, counts)

    def messages(self, wanted: Mapping[int, bool], from_ns: int | None = None) -> Iterator[Message]:
        with self.notes.told_before():
            yield from self._read(wanted)

    def close(self) -> None:
        """Nothing is open between readings."""

    def _compare(self, summary: _Summary, counts: Mapping[int, int]) -> None:
        """Note what the summary says otherwise than the data."""
        if summary.damaged:
            self.notes.add("its summary is damaged: all of its messages were read", bad=False)
            return
        if summary.places and summary.places != self._places:
            self.notes.add("damaged: its chunks are not where its index has them", bad=True)
        for number, channel in self._known.items():
            other = summary.channels.get(number, channel)
            if other != channel:
                reason = f"it calls a topic /{channel.topic}, and in its summary /{other.topic}, or its type"
                self.notes.add(f"damaged: {reason} otherwise", bad=True)
        if summary.counts is not None and dict(summary.counts) != dict(counts):
            told, there = sum(summary.counts.values()), sum(counts.values())
            reason = f"{there} messages are there, and by its summary {told}, or of other topics"
            self.notes.add(f"damaged: {reason}", bad=True)

    def _read(
        self, wanted: Mapping[int, bool], *, every: bool = False, summary: _Summary | None = None
    ) -> Iterator[Message]:
        try:
            with self._path.open("rb") as file:
                yield from self._of_file(file, wanted, every, summary)
        except GeneratorExit:
            raise
        except Exception as error:  # noqa: BLE001  # decompressors raise what they like
            self.cut = f"cut off or damaged ({damage_of(error)})"

    def _of_file(
        self, file: BinaryIO, wanted: Mapping[int, bool], every: bool, summary: _Summary | None
    ) -> Iterator[Message]:
        end = file.seek(0, 2)
        file.seek(8)
        schemas: dict[int, Schema] = {}
        at = 8
        last_ns: int | None = None
        while True:
            head = file.read(RECORD.size)
            operation, length = RECORD.unpack(head) if len(head) == RECORD.size else (0, 0)
            if not operation or at + RECORD.size + length > end:
                self.cut = f"cut off or damaged at byte {at} of {end}"
                if operation == CHUNK:
                    yield from self._left(schemas, wanted, every)
                return
            if operation == CHUNK:
                self._places.add(at)
                try:
                    found = self._of_chunk(file, at, length, schemas, wanted, every)
                except DAMAGE as error:
                    self.notes.add(f"the chunk at byte {at} is damaged: {damage_of(error)}", bad=True)
                    if last_ns is not None:
                        yield hole(last_ns, last_ns)
                    file.seek(at + RECORD.size + length)
                else:
                    yield from found
                    last_ns = found[-1][0] if found else last_ns
            elif operation in (SCHEMA, CHANNEL, MESSAGE):
                if length > LARGEST_CHUNK:
                    raise ReaderError(_too_large(length))
                content = file.read(length)
                self.checked = self.checked and None
                if operation == MESSAGE:
                    message = self._message(content, 0, length, wanted, every)
                    if message is not None:
                        last_ns = message[0]
                        yield message
                else:
                    _declared(operation, content, schemas, self._known)
            elif operation in (DATA_END, FOOT):
                if summary is not None:
                    self._summary(file, at, end, summary)
                return
            elif operation == MESSAGE_INDEX:
                (_, size) = struct.unpack("<HI", file.read(6))
                if size + 6 != length:
                    raise ReaderError(f"an index at byte {at}")
                file.seek(at + RECORD.size + length)
            elif operation in (ATTACHMENT, METADATA) or (operation == HEADER and at == 8) or operation > 127:
                file.seek(at + RECORD.size + length)
            else:
                raise ReaderError(f"an unknown record at byte {at}")
            at += RECORD.size + length

    def _of_chunk(
        self,
        file: BinaryIO,
        at: int,
        length: int,
        schemas: dict[int, Schema],
        wanted: Mapping[int, bool],
        every: bool,
    ) -> list[Message]:
        if length > LARGEST_CHUNK:
            raise ReaderError(_too_large(length))
        content = file.read(length)
        first_ns, last_ns, size, crc, name_bytes = CHUNK_HEAD.unpack_from(content)
        begin = CHUNK_HEAD.size + name_bytes + 8
        name = content[CHUNK_HEAD.size : begin - 8].decode("ascii")
        if size > LARGEST_CHUNK:
            raise ReaderError(_too_large(size))
        if not crc:
            unsure = name and not has_checksum(content[begin : begin + HEAD_BYTES])
            self.checked = False if unsure else self.checked and None
        data = _unpacked(content[begin:], name, size, crc)
        found = []
        for operation, place, end in _places(data):
            if operation == MESSAGE:
                message = self._message(data, place, end, wanted, every)
                if message is None:
                    continue
                if crc or first_ns <= message[0] <= last_ns:
                    found.append(message)
                else:
                    self.notes.add("a stamp is not between those of its chunk: left out", bad=True)
            else:
                _declared(operation, data[place:end], schemas, self._known)
        return found

    def _message(
        self, data: bytes, begin: int, end: int, wanted: Mapping[int, bool], every: bool
    ) -> Message | None:
        if end - begin < MESSAGE_HEAD.size:
            raise ReaderError("a message is shorter than its head")
        number, _, time_ns, _ = MESSAGE_HEAD.unpack_from(data, begin)
        if number not in self._known:
            self.notes.add("a message is of a topic that is not declared", bad=True)
            return None
        if not every and number not in wanted:
            return None
        return _time(time_ns), number, data[begin + MESSAGE_HEAD.size : end] if wanted.get(number) else None

    def _left(self, schemas: dict[int, Schema], wanted: Mapping[int, bool], every: bool) -> Iterator[Message]:
        """Yield the messages of the chunk in which the file ends."""
        try:
            for operation, content in left_of_chunk(self._path):
                if operation == MESSAGE:
                    message = self._message(content, 0, len(content), wanted, every)
                    if message is not None:
                        yield message
                else:
                    _declared(operation, content, schemas, self._known)
        except GeneratorExit:
            raise
        except Exception as error:  # noqa: BLE001  # as above; what came before it counts
            self.cut = f"{self.cut}, its last chunk damaged ({type(error).__name__})"

    def _summary(self, file: BinaryIO, at: int, end: int, summary: _Summary) -> None:
        """Note what is behind the data, and refuse what is no end of a file."""
        file.seek(at)
        rest = file.read(end - at)
        if rest[-8:] != MAGIC:
            raise ReaderError("it does not end as it should")
        try:
            _is_checked(file)
            for operation, content in _records(rest[:-8]):
                if operation == STATISTICS:
                    summary.counts = Statistics.read(ReadDataStream(BytesIO(content))).channel_message_counts
                elif operation == CHUNK_INDEX:
                    summary.places.add(CHUNK_PLACE.unpack_from(content)[2])
                elif operation in (SCHEMA, CHANNEL):
                    _declared(operation, content, summary.schemas, summary.channels)
        except DAMAGE:
            summary.damaged = True


def _is_checked(file: BinaryIO) -> bool:
    """Return whether the summary has a checksum; ReaderError if it is another one."""
    end = file.seek(-END_BYTES, 2)
    foot = file.read(END_BYTES)
    start, _, crc = FOOTER.unpack_from(foot, RECORD.size)
    if not crc:
        return False
    begin = start or end
    file.seek(begin)
    if not 0 < begin <= end or crc32(file.read(end + RECORD.size + 16 - begin)) != crc:
        raise ReaderError("its summary is damaged")
    return True


def _places(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield of each record its operation, and where its content begins and ends; ReaderError if damaged."""
    at, end = 0, len(data)
    unpack = RECORD.unpack_from
    while at < end:
        operation, length = unpack(data, at)
        begin = at + RECORD.size
        at = begin + length
        if at > end:
            raise ReaderError("a record is longer than what it is in")
        yield operation, begin, at


def _records(data: bytes) -> Iterator[tuple[int, bytes]]:
    for operation, begin, end in _places(data):
        yield operation, data[begin:end]


def _walked(data: bytes) -> Found:
    """Return all messages of a chunk, as it says itself."""
    found: dict[int, tuple[list[int], list[int], list[int]]] = {}
    for operation, begin, end in _places(data):
        if operation == MESSAGE:
            if end - begin < MESSAGE_HEAD.size:
                raise ReaderError("a message is shorter than its head")
            channel, _, time_ns, _ = MESSAGE_HEAD.unpack_from(data, begin)
            times, begins, ends = found.setdefault(channel, ([], [], []))
            times.append(_time(time_ns))
            begins.append(begin + MESSAGE_HEAD.size)
            ends.append(end)
        elif operation not in (SCHEMA, CHANNEL):
            raise ReaderError(f"a record {operation} in a chunk")
    return {
        channel: (np.array(one[0], np.int64), np.array(one[1], np.int64), np.array(one[2], np.int64))
        for channel, one in found.items()
    }


def _checked(
    index: Mapping[int, tuple[Times, Times]],
    chunk: ChunkInfo,
    data: bytes | None,
    wanted: Mapping[int, bool],
) -> Found | None:
    """Return the messages to which an index leads; None if it is to be doubted."""
    found: dict[int, tuple[Times, Times, Times]] = {}
    first_ns, last_ns = _time(chunk.message_start_time), _time(chunk.message_end_time)
    packed = np.frombuffer(data or b"", np.uint8)
    for channel, (times_ns, places) in index.items():
        if not len(times_ns):
            continue
        if data is None or not wanted.get(channel):
            if not in_order(times_ns) or times_ns[0] < first_ns or times_ns[-1] > last_ns:
                return None
            found[channel] = times_ns, places, places
            continue
        if places[0] < 0 or places[-1] + RECORD.size + MESSAGE_HEAD.size > len(packed):
            return None
        heads = gathered(packed, places, HEAD)
        lengths = heads["length"].astype(np.int64)
        if (
            (heads["operation"] != MESSAGE)
            | (heads["channel"] != channel)
            | (heads["time"].astype(np.int64) != times_ns)
            | (lengths < MESSAGE_HEAD.size)
            | (lengths > len(packed) - RECORD.size - places)
        ).any():
            return None
        ends = places + (RECORD.size + lengths)
        found[channel] = times_ns, places + (RECORD.size + MESSAGE_HEAD.size), ends
    return found


def _time(time_ns: int) -> int:
    return min(time_ns, LATEST)


def _too_large(size: int) -> str:
    return f"it says that it holds {size:,} bytes; more than {LARGEST_CHUNK >> 20} MB are not read"


def _unpacked(packed: bytes, compression: str, size: int, crc: int) -> bytes:
    """Return what a chunk holds; ReaderError, or whatever comes of damaged bytes."""
    data = unpacked(compression, packed, size + 1)
    if len(data) != size:
        raise ReaderError(f"it holds {len(data)} bytes and not {size}")
    if crc and crc32(data) != crc:
        raise ReaderError("its checksum is another one")
    return data


def _declared(
    operation: int, content: bytes, schemas: dict[int, Schema], channels: dict[int, Channel]
) -> None:
    """Note a schema or a channel."""
    stream = ReadDataStream(BytesIO(content))
    if operation == SCHEMA:
        schema = Schema.read(stream)
        schemas.setdefault(schema.id, schema)
    elif operation == CHANNEL:
        record = ChannelRecord.read(stream)
        of = schemas.get(record.schema_id)
        channel = Channel(
            record.id,
            record.topic.removeprefix("/"),
            "" if of is None else _type_name(of),
            "" if of is None else of.data.decode("utf-8", errors="replace"),
            of is not None and "idl" in of.encoding,
            record.message_encoding != "ros1",
        )
        if channels.setdefault(record.id, channel) != channel:
            raise ReaderError("it declares a topic twice, and otherwise")
    else:
        raise ReaderError(f"a record {operation} in a chunk")


def _type_name(schema: Schema) -> str:
    """Return the name of a type as rosbags has it; ROS 1 leaves out the `msg`."""
    name = schema.name
    return name.replace("/", "/msg/", 1) if schema.encoding == "ros1msg" and name.count("/") == 1 else name


def _channel(connection: Connection) -> Channel:
    return Channel(
        connection.id,
        connection.topic.removeprefix("/"),
        "" if connection.msgtype == "__schemaless__" else connection.msgtype,
        connection.msgdef.data,
        connection.msgdef.format == MessageDefinitionFormat.IDL,
        getattr(connection.ext, "serialization_format", "cdr") != "ros1",
    )
