"""TCPROS: bytes to headers and messages and back. No sockets, no clocks.

    | length, u32 LE | header: fields |  then  | length, u32 LE | message |  again and again
                       └ | length, u32 LE | name=value |

Source: wiki.ros.org/ROS/TCPROS and /Connection Header. Golden bytes are in tests/clients/bridges/ros1.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

from robomend_client.bridges.problems import Complaint

LENGTH = struct.Struct("<I")

LONGEST_HEADER = 1024 * 1024
LONGEST_MESSAGE = 256 * 1024 * 1024
"""Bytes. A map of 16,000 by 16,000 cells fits; what peers that do not speak TCPROS send, read as a length, is
mostly beyond it.
"""


class ProtocolError(Complaint):
    """The bytes are no TCPROS; the connection is of no use any more."""


def frame(body: bytes) -> bytes:
    """Return a message with its length."""
    return LENGTH.pack(len(body)) + body


def encode_header(fields: Mapping[str, str]) -> bytes:
    """Return a header with its length."""
    return frame(b"".join(frame(f"{name}={value}".encode()) for name, value in fields.items()))


def decode_header(body: bytes) -> dict[str, str]:
    """Return the fields of a header, which came without its length.

    Raises:
        ProtocolError: it is none.
    """
    fields: dict[str, str] = {}
    at = 0
    while at < len(body):
        if at + LENGTH.size > len(body):
            raise ProtocolError("a header that breaks off")
        (length,) = LENGTH.unpack_from(body, at)
        at += LENGTH.size
        if at + length > len(body):
            raise ProtocolError("a header field that is longer than its header", f"{length} bytes")
        name, equals, value = body[at : at + length].partition(b"=")
        if not equals:
            raise ProtocolError("a header field without `=`", repr(name[:40]))
        fields[name.decode("utf-8", "replace")] = value.decode("utf-8", "replace")
        at += length
    return fields


class TcprosDecoder:
    """Cuts a byte stream, split anywhere, into a header and messages.

    With `keep` False messages after the header that are longer than `up_to` bytes are counted and not kept:
    their bytes are let go as they come, however long they are.
    """

    def __init__(self, keep: bool, up_to: int = 0) -> None:
        self._up_to = LONGEST_MESSAGE if keep else up_to
        self.header: dict[str, str] | None = None
        self.longest = 0  # of the messages that have begun
        self._buffer = bytearray()
        self._skip = 0  # bytes to come of a message that nobody looks at

    @property
    def within(self) -> bool:
        """Whether the rest of something is still to come."""
        return self._skip > 0 or len(self._buffer) > 0

    def receive(self, data: bytes | memoryview) -> list[bytes]:
        """Take in bytes; return the messages that are whole now, empty ones where they are not kept.

        Raises:
            ProtocolError: this is no TCPROS.
        """
        size = len(data)
        if not self._skip and not self._buffer and self.header is not None and size >= LENGTH.size:
            (length,) = LENGTH.unpack_from(data)
            if size == LENGTH.size + length:  # one message, whole: mostly it is
                self.longest = max(self.longest, length)
                return [bytes(data[LENGTH.size :]) if length <= self._up_to else b""]
        found: list[bytes] = []
        if self._skip:
            if len(data) < self._skip:
                self._skip -= len(data)
                return found
            data = data[self._skip :]
            self._skip = 0
            found.append(b"")
        buffer = self._buffer
        buffer += data
        while len(buffer) >= LENGTH.size:
            (length,) = LENGTH.unpack_from(buffer)
            longest = LONGEST_HEADER if self.header is None else LONGEST_MESSAGE
            if length > longest:
                what = "header" if self.header is None else "message"
                raise ProtocolError(f"a {what} that is too long", f"{length} bytes")
            end = LENGTH.size + length
            if self.header is not None:
                self.longest = max(self.longest, length)
            if self.header is not None and length > self._up_to:
                if len(buffer) < end:
                    self._skip = end - len(buffer)
                    buffer.clear()
                    break
                found.append(b"")
            elif len(buffer) < end:
                break
            elif self.header is None:
                self.header = decode_header(bytes(buffer[LENGTH.size : end]))
            else:
                found.append(bytes(buffer[LENGTH.size : end]))
            del buffer[:end]
        return found
