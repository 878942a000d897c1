"""What is left of an .mcap's last chunk where the file ends in the middle of it.

    record: operation, u8 | length, u64 | content        operation 6: a chunk
    chunk: start, end, size, u64 each | crc, u32 | compression | length, u64 | records

Chunks hold a second or more, and what a robot recorded last is what one wants to know of it.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from robomend_batch.logs import lz4_cut
from robomend_batch.logs.chunk import LARGEST_CHUNK

if sys.version_info >= (3, 14):
    from compression import zstd as zstd
else:
    from backports import zstd as zstd

ZstdError = zstd.ZstdError

MAGIC_BYTES = 8
RECORD = struct.Struct("<BQ")
HEAD = struct.Struct("<QQQII")
LENGTH = struct.Struct("<Q")
SCHEMA, CHANNEL, MESSAGE, CHUNK = 3, 4, 5, 6


HEAD_BYTES, CHECKSUM = 5, 0x04
"""Of a frame of zstd or of lz4: its magic, and the flags with that of a checksum of what it holds."""


def has_checksum(frame: bytes) -> bool:
    """Return whether a frame of zstd or of lz4 says that it has a checksum of what it holds."""
    return len(frame) >= HEAD_BYTES and bool(frame[HEAD_BYTES - 1] & CHECKSUM)


def left_of_chunk(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield operation and content of the whole records of the chunk in which a file ends; none if it ends
    elsewhere.
    """
    with path.open("rb") as file:
        packed = _cut_chunk(file)
    if packed is None:
        return
    data = unpacked(*packed)
    at = 0
    while at + RECORD.size <= len(data):
        operation, length = RECORD.unpack_from(data, at)
        at += RECORD.size
        if at + length > len(data):
            return
        if operation in (SCHEMA, CHANNEL, MESSAGE):
            yield operation, data[at : at + length]
        at += length


def _cut_chunk(file: BinaryIO) -> tuple[str, bytes] | None:
    """Return compression and bytes of the chunk in which a file ends."""
    end = file.seek(0, 2)
    at = MAGIC_BYTES
    while at + RECORD.size <= end:
        file.seek(at)
        operation, length = RECORD.unpack(file.read(RECORD.size))
        at += RECORD.size + length
        if at <= end:
            continue
        content = file.read(LARGEST_CHUNK) if operation == CHUNK else b""
        if len(content) < HEAD.size:
            return None
        name_bytes = HEAD.unpack_from(content)[-1]
        begin = HEAD.size + name_bytes + LENGTH.size
        return content[HEAD.size : HEAD.size + name_bytes].decode("ascii", "replace"), content[begin:]
    return None


def unpacked(compression: str, data: bytes, most: int = LARGEST_CHUNK) -> bytes:
    """Return what a chunk holds, of one that is cut off as much as there is, and at most so many bytes.

    Raises:
        ValueError: it is packed in another way.
    """
    if compression == "":
        return data
    if compression == "zstd":
        found = []
        while data and most > 0:  # there may be several frames
            frame = zstd.ZstdDecompressor()
            found.append(frame.decompress(data, max_length=most))
            most -= len(found[-1])
            data = frame.unused_data if frame.eof else b""
        return found[0] if len(found) == 1 else b"".join(found)
    if compression == "lz4":
        return lz4_cut.unpacked(data, most)
    raise ValueError(f"packed by {compression}, which is not known")
