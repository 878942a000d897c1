"""Power-board frames to messages and back. No sockets, no clocks, no threads.

    | 0x02 | command, u8 | length, u16 LE | body, length bytes |

The same codec serves both ends: which message may come when is the business of the session (client) and of
the conversation (emulator). Three things can be wrong with what arrives, and each is treated for what it
is:

- no frame can be cut out (wrong delimiter, a length beyond any message): RemoteProtocolError. Nothing in
  the stream marks the next frame, so the caller must drop the connection;
- a whole frame says nothing to us (unknown command, body of the wrong shape): an `Unreadable` value. The
  stream is still in step: a board answers with the code that `Unreadable` carries, a client drops the
  connection;
- a float is NaN or infinite: the frame is good and that one number is unknown, None. A sensor that fails on
  one channel must not cost the states of the other nine, nor the power to switch them.

Adding a message: write its dataclass, add it to MESSAGES, add a golden frame to tests/board/test_codec.py,
and give it its rows in robomend.board.session and robomend_board.server. The emulator uses this
module too, so the golden frames are the only independent witness of the layout: take them from the board's
manual or a capture, never from this encoder.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar

from robomend.errors import LocalProtocolError, RemoteProtocolError

DELIMITER = 0x02
HEADER = struct.Struct("<BBH")  # delimiter, command, body length in bytes
LIMITS = struct.Struct("<ff")  # of one channel: max current A, max voltage V
READING = struct.Struct("<Bff")  # of one channel: on, current A, voltage V
MAX_CHANNELS = 255  # n is a u8
MAX_BODY = 1 + MAX_CHANNELS * READING.size  # measurements of 255 channels are the longest message
MAX_BUFFER = 1 << 19  # of bytes received and not yet taken out as messages; asyncio reads 1 << 18 at most


class Code(IntEnum):
    """What a board's acknowledge says."""

    OK = 0
    UNKNOWN_CHANNEL = 1
    BAD_VALUE = 2
    CHANNEL_FAULTY = 3
    UNKNOWN_COMMAND = 4


@dataclass(frozen=True, slots=True)
class ChannelLimits:
    """What one channel may carry; None where the board gives no finite number."""

    max_current_a: float | None
    max_voltage_v: float | None


@dataclass(frozen=True, slots=True)
class ChannelReading:
    """One channel's switch and sensors; None where the sensor gives no finite number."""

    on: bool
    current_a: float | None
    voltage_v: float | None


@dataclass(frozen=True, slots=True)
class Specification:
    """Board to client, first on every connection: how many channels there are, and their limits."""

    command: ClassVar[int] = 0
    channels: tuple[ChannelLimits, ...]

    def body(self) -> bytes:
        packed = (LIMITS.pack(_wire(c.max_current_a), _wire(c.max_voltage_v)) for c in self.channels)
        return struct.pack("<B", len(self.channels)) + b"".join(packed)

    @classmethod
    def from_body(cls, body: bytes) -> Specification:
        rows = LIMITS.iter_unpack(_rows(body, LIMITS.size))
        return cls(tuple(ChannelLimits(_known(a), _known(v)) for a, v in rows))


@dataclass(frozen=True, slots=True)
class Broadcast:
    """Client to board: send measurements at this rate on this connection; 0 stops them."""

    command: ClassVar[int] = 1
    frequency_hz: int

    def body(self) -> bytes:
        return struct.pack("<B", self.frequency_hz)

    @classmethod
    def from_body(cls, body: bytes) -> Broadcast:
        return cls(*struct.unpack("<B", body))


@dataclass(frozen=True, slots=True)
class Measurements:
    """Board to client: every channel's switch and sensors, in the order of the channels."""

    command: ClassVar[int] = 2
    channels: tuple[ChannelReading, ...]

    def body(self) -> bytes:
        packed = (READING.pack(bool(c.on), _wire(c.current_a), _wire(c.voltage_v)) for c in self.channels)
        return struct.pack("<B", len(self.channels)) + b"".join(packed)

    @classmethod
    def from_body(cls, body: bytes) -> Measurements:
        readings = []
        for on, current_a, voltage_v in READING.iter_unpack(_rows(body, READING.size)):
            if on not in (0, 1):
                raise ValueError(f"a channel's state is {on}, not 0 or 1")
            readings.append(ChannelReading(bool(on), _known(current_a), _known(voltage_v)))
        return cls(tuple(readings))


@dataclass(frozen=True, slots=True)
class Request:
    """Client to board: acknowledge, then send measurements once."""

    command: ClassVar[int] = 3

    def body(self) -> bytes:
        return b""

    @classmethod
    def from_body(cls, body: bytes) -> Request:
        if len(body) > 1:  # one historic client sends one extra byte
            raise ValueError(f"a request has an empty body, not {len(body)} bytes")
        return cls()


@dataclass(frozen=True, slots=True)
class SwitchChannel:
    """Client to board: switch one power channel.

    `state` is 1 for on and 0 for off. Received, it can be any byte: refusing it takes an acknowledge, not
    an exception.
    """

    command: ClassVar[int] = 4
    channel: int
    state: int

    def body(self) -> bytes:
        if self.state not in (0, 1):
            raise ValueError(f"state {self.state}, not 0 or 1")
        return struct.pack("<BB", self.channel, self.state)

    @classmethod
    def from_body(cls, body: bytes) -> SwitchChannel:
        return cls(*struct.unpack("<BB", body))


@dataclass(frozen=True, slots=True)
class Acknowledge:
    """Board to client: the answer to one command; see Code."""

    command: ClassVar[int] = 5
    code: int

    def body(self) -> bytes:
        return struct.pack("<B", self.code)

    @classmethod
    def from_body(cls, body: bytes) -> Acknowledge:
        return cls(*struct.unpack("<B", body))


Message = Specification | Broadcast | Measurements | Request | SwitchChannel | Acknowledge
MESSAGES: dict[int, type[Message]] = {
    m.command: m for m in (Specification, Broadcast, Measurements, Request, SwitchChannel, Acknowledge)
}


@dataclass(frozen=True, slots=True)
class Unreadable:
    """A whole frame that is none of the six messages, and the code with which a board answers it."""

    code: Code
    reason: str


def encode(message: Message) -> bytes:
    """Return the frame; LocalProtocolError if a field does not fit."""
    try:
        body = message.body()
    except (struct.error, OverflowError, ValueError) as error:
        raise LocalProtocolError(f"{message}: {error}") from error
    return HEADER.pack(DELIMITER, message.command, len(body)) + body


class Decoder:
    """Cuts a byte stream, split anywhere, into messages.

    With every message taken out, less than one frame is left in the buffer, and no frame exceeds MAX_BODY.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()

    @property
    def buffered(self) -> int:
        """The number of bytes that wait for the rest of their frame."""
        return len(self._buffer)

    def receive(self, data: bytes) -> None:
        """Take bytes from the stream. Call next_message until it returns None before the next call."""
        if len(self._buffer) + len(data) > MAX_BUFFER:
            raise LocalProtocolError(
                f"{len(self._buffer)} bytes are waiting: take the messages out before more are received"
            )
        self._buffer += data

    def next_message(self) -> Message | Unreadable | None:
        """Return the next message, or None until more bytes arrive.

        Raises:
            RemoteProtocolError: the bytes are no frame. The stream has no way to find the next frame, so
                the caller must drop the connection.
        """
        if not self._buffer:
            return None
        if self._buffer[0] != DELIMITER:
            raise RemoteProtocolError(f"a frame starts with {self._buffer[0]:#04x}, not 0x02")
        if len(self._buffer) < HEADER.size:
            return None
        _, command, length = HEADER.unpack_from(self._buffer)
        if length > MAX_BODY:
            raise RemoteProtocolError(f"command {command} with {length} bytes; no message exceeds {MAX_BODY}")
        end = HEADER.size + length
        if len(self._buffer) < end:
            return None
        body = bytes(self._buffer[HEADER.size : end])
        del self._buffer[:end]
        return _message(command, body)


def _message(command: int, body: bytes) -> Message | Unreadable:
    message_type = MESSAGES.get(command)
    if message_type is None:
        return Unreadable(Code.UNKNOWN_COMMAND, f"there is no command {command}")
    try:
        return message_type.from_body(body)
    except (struct.error, ValueError) as error:
        return Unreadable(Code.BAD_VALUE, f"command {command} with {len(body)} bytes: {error}")


def _rows(body: bytes, size: int) -> bytes:
    if not body or len(body) != 1 + body[0] * size:
        raise ValueError(f"not n × {size} bytes after n")
    return body[1:]


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _wire(value: float | None) -> float:
    """Unknown travels as NaN; a number that is not finite must be written as None, so that nobody computes
    with it.
    """
    if value is None:
        return math.nan
    if not math.isfinite(value):
        raise ValueError(f"{value} is no reading: write None for an unknown one")
    return value
