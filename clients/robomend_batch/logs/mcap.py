"""ROS 2 recordings in MCAP.

With an index, only what is wanted is touched: of topics whose stamps suffice the index alone, so that most of
the file is never read; of the others the chunks that hold them. Without one, or cut off, the file is read
as a stream, up to where it ends.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from mcap.exceptions import EndOfFile, McapError
from mcap.reader import NonSeekingReader
from mcap.records import Channel as ChannelRecord
from mcap.records import Schema
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.storage_mcap import ChunkInfo, McapReader, decompress

from robomend_batch.logs.chunk import RECORD, Chunk
from robomend_batch.logs.mcap_chunk import ZstdError, left_of_chunk
from robomend_batch.logs.recorded import DAMAGED, Channel, Message, Recording, Stretch, Times, Unreadable

INDEX = np.dtype([("time", "<u8"), ("offset", "<u8")])
INDEX_HEAD = struct.Struct("<BQHI")
MESSAGE_INDEX = 7

LARGEST_CHUNK = 1 << 30

DAMAGE = (*DAMAGED, ReaderError, McapError, ZstdError)


def open_mcap(path: Path) -> Recording:
    """Return a recording; Unreadable if nothing of it can be read."""
    try:
        indexed = IndexedMcap(path)
    except DAMAGE:
        return StreamedMcap(path)
    if indexed.usable:
        return indexed
    indexed.close()
    return StreamedMcap(path)


class IndexedMcap:
    """A whole file with an index of its chunks."""

    by_time = True

    def __init__(self, path: Path) -> None:
        self._reader = McapReader(path)
        self._reader.open()
        self.channels = [_channel(connection) for connection in self._reader.connections]
        self.cut: str | None = None
        statistics = self._reader.statistics
        some = statistics is not None and statistics.message_count > 0
        self.start_ns = statistics.start_time if statistics is not None and some else None
        self.end_ns = statistics.end_time if statistics is not None and some else None
        self._file = path.open("rb")

    @property
    def usable(self) -> bool:
        """Whether all of its messages are in chunks with an index."""
        chunks = self._reader.chunks
        known = {channel.number for channel in self.channels}
        return self.start_ns is None or (
            bool(chunks)
            and all(chunk.message_index_length and chunk.message_index_offsets for chunk in chunks)
            and all(known.issuperset(chunk.message_index_offsets) for chunk in chunks)
        )

    def close(self) -> None:
        self._file.close()
        self._reader.close()

    def messages(self, wanted: Mapping[int, bool], from_ns: int | None = None) -> Iterator[Message]:
        for stretch, _ in self.stretches(wanted):
            yield from (message for message in stretch if from_ns is None or message[0] >= from_ns)

    def stretches(
        self, wanted: Mapping[int, bool], place: tuple[int, int] | None = None
    ) -> Iterator[Stretch]:
        """Yield the messages chunk by chunk: as a Chunk, where no other chunk has messages in between.

        A place is two chunks: the next one, and the first one that may have left messages behind it.
        """
        chunks = sorted(
            (
                chunk
                for chunk in self._reader.chunks
                if not wanted.keys().isdisjoint(chunk.message_index_offsets)
            ),
            key=lambda chunk: (chunk.message_start_time, chunk.chunk_start_offset),
        )
        since, begin = place or (0, 0)
        waiting = self._left_behind(chunks[since : begin + 1], wanted)
        for number in range(begin, len(chunks)):
            chunk = chunks[number]
            following = chunks[number + 1] if number + 1 < len(chunks) else None
            if waiting:  # chunks may overlap: what is before the next one's first message is in its place
                ready = [message for message in waiting if message[0] < chunk.message_start_time]
                if ready:
                    waiting = waiting[len(ready) :]
                    yield ready, (since, number)
            if not waiting:
                since = number
            try:
                found = self._of_chunk(chunk, wanted)
                if not waiting and (following is None or found.until_ns <= following.message_start_time):
                    yield found, (number + 1, number + 1)
                    continue
                waiting += found
            except DAMAGE as error:
                self.cut = f"damaged: {error}"
                break
            waiting.sort(key=itemgetter(0))
        if waiting:
            yield waiting, None if self.cut else (len(chunks), len(chunks))

    def _left_behind(self, chunks: Sequence[ChunkInfo], wanted: Mapping[int, bool]) -> list[Message]:
        """Return the messages of chunks that do not come before the last one of them."""
        left: list[Message] = []
        for chunk in chunks[:-1]:
            if chunk.message_end_time >= chunks[-1].message_start_time:
                left += (
                    message
                    for message in self._of_chunk(chunk, wanted)
                    if message[0] >= chunks[-1].message_start_time
                )
        return sorted(left, key=itemgetter(0))

    def _of_chunk(self, chunk: ChunkInfo, wanted: Mapping[int, bool]) -> Chunk:
        self._file.seek(chunk.chunk_start_offset + chunk.chunk_length)
        block = self._file.read(chunk.message_index_length)
        found: dict[int, tuple[Times, Times]] = {}
        data: bytes | None = None
        at = 0
        while at + INDEX_HEAD.size <= len(block):
            operation, length, channel, size = INDEX_HEAD.unpack_from(block, at)
            if operation != MESSAGE_INDEX:
                raise ReaderError("its index is damaged")
            if channel in wanted and size >= INDEX.itemsize:
                index = np.frombuffer(block, INDEX, size // INDEX.itemsize, at + INDEX_HEAD.size)
                times_ns, places = index["time"].astype(np.int64), index["offset"].astype(np.int64)
                if channel in found:
                    times_ns = np.concatenate([found[channel][0], times_ns])
                    places = np.concatenate([found[channel][1], places])
                order = np.argsort(places, kind="stable")
                found[channel] = times_ns[order], places[order]
                if wanted[channel] and data is None:
                    data = self._data(chunk)
            at += RECORD.size + length
        messages = Chunk(found, wanted, data)
        messages.check()
        return messages

    def _data(self, chunk: ChunkInfo) -> bytes:
        if chunk.uncompressed_size > LARGEST_CHUNK:
            raise ReaderError(f"a chunk of {chunk.uncompressed_size} bytes")
        self._file.seek(chunk.chunk_start_offset + RECORD.size + 24)
        (crc,) = struct.unpack("<I", self._file.read(4))
        self._file.seek(chunk.chunk_start_offset + RECORD.size + 40 + len(chunk.compression))
        packed = self._file.read(chunk.compressed_size)
        return decompress(packed, chunk.compression, chunk.uncompressed_size, crc)


class StreamedMcap:
    """A file without an index, or without its end. It is read twice: for what is in it, and for that."""

    by_time = False

    def __init__(self, path: Path) -> None:
        self._path = path
        self.channels: list[Channel] = []
        self.start_ns: int | None = None
        self.end_ns: int | None = None
        self.cut: str | None = None
        known: dict[int, Channel] = {}
        for schema, channel, message in self._read():
            if channel.id not in known:
                known[channel.id] = Channel(
                    channel.id,
                    channel.topic.removeprefix("/"),
                    "" if schema is None else schema.name,
                    "" if schema is None else schema.data.decode("utf-8", errors="replace"),
                    schema is not None and "idl" in schema.encoding,
                    channel.message_encoding != "ros1",
                )
            self.start_ns = min(message.log_time, self.start_ns or message.log_time)
            self.end_ns = max(message.log_time, self.end_ns or message.log_time)
        self.channels = list(known.values())
        if self.start_ns is None and self.cut is not None:
            raise Unreadable(self.cut)

    def messages(self, wanted: Mapping[int, bool], from_ns: int | None = None) -> Iterator[Message]:
        for _, channel, message in self._read():
            if channel.id in wanted:
                yield message.log_time, channel.id, message.data if wanted[channel.id] else None

    def close(self) -> None:
        """Nothing is open between readings."""

    def _read(self) -> Iterator[tuple[Any, Any, Any]]:
        channels: dict[int, tuple[Any, Any]] = {}
        try:
            with self._path.open("rb") as file:
                reader = NonSeekingReader(file, record_size_limit=LARGEST_CHUNK)
                for schema, channel, message in reader.iter_messages(log_time_order=False):
                    channels[channel.id] = schema, channel
                    yield schema, channel, message
        except GeneratorExit:
            raise
        except Exception as error:  # noqa: BLE001  # decompressors raise what they like at a cut
            self.cut = f"cut off or damaged ({type(error).__name__} {error})".replace(" )", ")")
            if isinstance(error, EndOfFile):
                yield from self._left(channels)

    def _left(self, channels: dict[int, tuple[Any, Any]]) -> Iterator[tuple[Any, Any, Any]]:
        """Yield the messages of the chunk in which the file ends."""
        schemas = {schema.id: schema for schema, _ in channels.values() if schema is not None}
        try:
            for record in left_of_chunk(self._path):
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, ChannelRecord):
                    channels[record.id] = schemas.get(record.schema_id), record
                elif record.channel_id in channels:
                    yield *channels[record.channel_id], record
        except GeneratorExit:
            raise
        except Exception as error:  # noqa: BLE001  # as above; what came before it counts
            self.cut = f"{self.cut}, its last chunk damaged ({type(error).__name__})"


def _channel(connection: Connection) -> Channel:
    return Channel(
        connection.id,
        connection.topic.removeprefix("/"),
        connection.msgtype,
        connection.msgdef.data,
        connection.msgdef.format == MessageDefinitionFormat.IDL,
        getattr(connection.ext, "serialization_format", "cdr") != "ros1",
    )
