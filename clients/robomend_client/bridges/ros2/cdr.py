"""CDR, version 1, as DDS has it on the wire: what little of it the bridge itself reads and writes.

    | 0x00 | 0x01: little endian | options, 2 bytes | values, each aligned to its own size |

Messages of any other type are read by what rosbags knows of them (messages.py); this spares robots that need
none its memory.
"""

from __future__ import annotations

import struct

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
