"""What is left of an LZ4 frame that ends in the middle: the library tells whole blocks only.

    frame: magic, u32 | flags, u8 | block size, u8 | content size, u64, if flagged | dictionary, u32, if
           flagged | checksum, u8 | blocks
    block: length, u32, its highest bit: as it is | sequences | checksum, u32, if flagged
    sequence: token, u8 | more of the first length | literals | offset, u16 | more of the second length
              its upper four bits: how many literals; its lower four: how many bytes to repeat, less four

A chunk of a bag is one block, of half a megabyte or more, and what a robot recorded last is what one wants to
know of it.

Source: https://github.com/lz4/lz4/tree/dev/doc, the descriptions of frame and block.
"""

from __future__ import annotations

import struct

from lz4.frame import LZ4FrameDecompressor

HEAD = 7
"""Bytes of a frame before its blocks, without what is flagged."""

CHECKED_BLOCKS, CONTENT_SIZE, DICTIONARY = 0x10, 0x08, 0x01
AS_IT_IS = 1 << 31
FURTHER = 15
"""A length of four bits that goes on in the next byte, …"""

FULL_BYTE = 255
"""… and a byte that does."""

LEAST_REPEATED = 4

LARGEST_BLOCK = 4 << 20
"""Unpacked; what is damaged could say more."""

REACH = 1 << 16
"""So far back is repeated at most."""

LENGTH, OFFSET = struct.Struct("<I"), struct.Struct("<H")


def unpacked(data: bytes, max_length: int = -1) -> bytes:
    """Return what a frame holds; of one that is cut off as much as there is.

    Args:
        data: the frame.
        max_length: of what is returned; -1: no bound.

    Raises:
        RuntimeError: it is no such frame, or damaged.
    """
    decompressor = LZ4FrameDecompressor()
    whole: bytes = decompressor.decompress(data, max_length=max_length)
    if decompressor.eof or len(data) < HEAD or len(whole) == max_length:
        return whole
    left = _of_block(_last_block(data), whole)
    return whole + (left if max_length < 0 else left[: max_length - len(whole)])


def _last_block(data: bytes) -> bytes:
    """Return what there is of the block in which a frame ends; nothing, if it is not packed."""
    flags = data[4]
    at = HEAD + (8 if flags & CONTENT_SIZE else 0) + (4 if flags & DICTIONARY else 0)
    while at + LENGTH.size <= len(data):
        length: int = LENGTH.unpack_from(data, at)[0]
        at += LENGTH.size
        if length & AS_IT_IS:
            length ^= AS_IT_IS
            if at + length > len(data):
                return b""
        elif at + length > len(data):
            return data[at:]
        at += length + (4 if flags & CHECKED_BLOCKS else 0)
    return b""


def _of_block(block: bytes, before: bytes) -> bytes:
    """Return what a block that is cut off says; `before` is what it may repeat of earlier ones."""
    found = bytearray(before[-REACH:])
    begins = len(found)
    at = 0
    try:
        while len(found) - begins < LARGEST_BLOCK:
            token = block[at]
            count, at = _length(block, at + 1, token >> 4)
            found += block[at : at + count]
            at += count
            (offset,) = OFFSET.unpack_from(block, at)
            count, at = _length(block, at + OFFSET.size, token & FURTHER)
            if not 0 < offset <= len(found):
                break  # damaged
            _repeat(found, offset, count + LEAST_REPEATED)
    except (IndexError, struct.error):
        pass  # here it is cut off
    return bytes(found[begins:])


def _length(block: bytes, at: int, count: int) -> tuple[int, int]:
    """Return a length that begins with four bits, and where what follows begins."""
    if count == FURTHER:
        while True:
            more = block[at]
            at += 1
            count += more
            if more != FULL_BYTE:
                break
    return count, at


def _repeat(found: bytearray, offset: int, count: int) -> None:
    """Append what stands so far back, which may reach into what is appended."""
    start = len(found) - offset
    pattern = found[start : start + count]
    while len(pattern) < count:
        pattern += pattern[: count - len(pattern)]
    found += pattern
