"""Server-sent events, cut from a byte stream. No sockets.

    id: 41 \\n event: diagnosis \\n data: {"time_ns": …, "robot": "tedusar", "data": {…}} \\n \\n

Lines end at \\n, \\r\\n or \\r and nowhere else: str.splitlines would also cut at U+2028 inside JSON. The
state that matters over a lost connection is `last_id`: the next request sends it as Last-Event-ID and misses
nothing.

Source: WHATWG HTML, section 9.2, Server-sent events.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from robomend_client.events import Event, Kind
from robomend_client.rest.errors import NotTheService

LONGEST_EVENT = 16 * 1024 * 1024
"""Bytes of one event; a stream that never ends an event must not fill the memory."""


@dataclass(frozen=True, slots=True)
class ServerSentEvent:
    """One event of the stream, with the id that stood when it was complete."""

    id: str
    name: str
    data: str


class EventDecoder:
    """Cuts a byte stream, split anywhere, into messages."""

    def __init__(self, last_id: str = "") -> None:
        self.last_id = last_id  # of the newest complete event
        self._id = last_id
        self.retry_s: float | None = None  # what the service asked for
        self._line = bytearray()
        self._after_cr = False
        self._begin()

    def reconnected(self) -> None:
        """Forget the half event of a lost connection, its id too: only what was complete counts."""
        self._id = self.last_id
        self._line.clear()
        self._after_cr = False
        self._begin()

    def receive(self, data: bytes) -> Iterator[ServerSentEvent]:
        """Yield the messages that `data` completes."""
        if self._after_cr and data:
            data = data.removeprefix(b"\n")
            self._after_cr = False
        if data.endswith(b"\r"):
            self._after_cr = True
        self._line += data
        if len(self._line) + self._size > LONGEST_EVENT:
            raise NotTheService(f"an event of more than {LONGEST_EVENT} bytes")
        if b"\n" not in data and b"\r" not in data:
            return  # a long line in small pieces: do not copy it for each of them
        *lines, rest = bytes(self._line).replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
        self._line = bytearray(rest)
        for line in lines:
            if message := self._take(line.decode("utf-8", "replace")):
                yield message

    def _begin(self) -> None:
        self._name = ""
        self._data: list[str] = []
        self._size = 0

    def _take(self, line: str) -> ServerSentEvent | None:
        if not line:
            self.last_id = self._id
            message = (
                ServerSentEvent(self.last_id, self._name or "message", "\n".join(self._data))
                if self._data
                else None
            )
            self._begin()
            return message
        field, _, value = line.partition(":")
        value = value.removeprefix(" ")
        if field == "data":
            self._data.append(value)
            self._size += len(value)
        elif field == "event":
            self._name = value
        elif field == "id" and "\0" not in value:
            self._id = value
        elif field == "retry" and value.isascii() and value.isdigit():
            self.retry_s = int(value) / 1000
        return None


def read_event(message: ServerSentEvent) -> Event | None:
    """Return the event, or None for a kind that this client does not know (the service may be newer)."""
    try:
        kind = Kind(message.name)
    except ValueError:
        return None
    try:
        value: dict[str, Any] = json.loads(message.data)
        return Event(
            id=int(message.id),
            time_ns=int(value["time_ns"]),
            kind=kind,
            robot=value.get("robot"),
            data=value.get("data") or {},
        )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise NotTheService(f"event {message.id!r} ({message.name}) cannot be read: {error}") from error
