"""HTTP/1.1 over keep-alive sockets, as cheap as it gets: the generator must not be what is measured.

A connection has one request under way and keeps the others until it is answered, as a robot would. Answers
are handed to a callback in the turn of the event loop in which their last byte came.
"""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import Callable
from typing import Any, cast
from urllib.parse import urlsplit

import httptools

Answered = Callable[[int, bytes], None]
"""Called with the status, 0 when the connection broke, and the body."""

ANSWER_S = 60.0


class ServiceGone(Exception):
    """The service broke a connection that something was asked on."""


def request(
    method: str, path: str, body: bytes = b"", content_type: str = "application/json", **headers: str
) -> bytes:
    """Return a request as it goes over the wire; `if_match` is written If-Match."""
    head = f"{method} {path} HTTP/1.1\r\nHost: localhost\r\n"
    for name, value in headers.items():
        head += f"{name.replace('_', '-')}: {value}\r\n"
    if body:
        head += f"Content-Type: {content_type}\r\nContent-Length: {len(body)}\r\n"
    return head.encode() + b"\r\n" + body


class Connection(asyncio.Protocol):
    """One keep-alive connection; see the module."""

    def __init__(self) -> None:
        self._parser = httptools.HttpResponseParser(self)
        self._transport: asyncio.Transport | None = None
        self._body: list[bytes] = []
        self._waiting: deque[tuple[bytes, Answered]] = deque()
        self.broken = False

    # --- asyncio

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)

    def data_received(self, data: bytes) -> None:
        try:
            self._parser.feed_data(data)
        except httptools.HttpParserError:
            self.close()

    def connection_lost(self, exc: Exception | None) -> None:
        self.broken = True
        waiting, self._waiting = self._waiting, deque()
        for _, answered in waiting:
            answered(0, b"")

    # --- httptools

    def on_body(self, body: bytes) -> None:
        """Take a piece of the answer's body."""
        self._body.append(body)

    def on_message_complete(self) -> None:
        """Hand the answer over and send what waited for it."""
        status, body = self._parser.get_status_code(), b"".join(self._body)
        self._body.clear()
        _, answered = self._waiting.popleft()
        if self._waiting:
            self._write(self._waiting[0][0])
        answered(status, body)

    # --- ours

    def send(self, wire: bytes, answered: Answered) -> None:
        """Send a request now, or after those that are under way."""
        if self.broken:
            answered(0, b"")
            return
        self._waiting.append((wire, answered))
        if len(self._waiting) == 1:
            self._write(wire)

    async def ask(self, wire: bytes) -> tuple[int, bytes]:
        """Send a request and return its answer; ServiceGone when the connection breaks."""
        future: asyncio.Future[tuple[int, bytes]] = asyncio.get_running_loop().create_future()

        def answered(status: int, body: bytes) -> None:
            if not future.done():
                future.set_result((status, body))

        self.send(wire, answered)
        async with asyncio.timeout(ANSWER_S):
            status, body = await future
        if status == 0:
            raise ServiceGone
        return status, body

    async def api(self, method: str, path: str, value: Any = None) -> Any:
        """Make a JSON request below /api/v1 that must succeed, and return its answer. A PUT replaces."""
        body = b"" if value is None else json.dumps(value).encode()
        status, answer = await self.ask(request(method, f"/api/v1{path}", body))
        if status == 428:
            status, answer = await self.ask(request(method, f"/api/v1{path}", body, if_match="*"))
        if not 200 <= status < 300:
            raise RuntimeError(f"{method} {path}: {status} {answer[:500].decode(errors='replace')}")
        return json.loads(answer) if answer else None

    def close(self) -> None:
        """Close it."""
        if self._transport is not None:
            self._transport.close()

    def _write(self, wire: bytes) -> None:
        assert self._transport is not None
        self._transport.write(wire)


class EventStream(asyncio.Protocol):
    """GET of an event stream: hands over each event as it comes, `id`, `event` and `data` lines and all."""

    def __init__(self, path: str, on_event: Callable[[bytes], None]) -> None:
        self._path = path
        self._on_event = on_event
        self._parser = httptools.HttpResponseParser(self)
        self._transport: asyncio.Transport | None = None
        self._rest = b""
        self.opened: asyncio.Future[int] = asyncio.get_running_loop().create_future()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self._transport.write(request("GET", self._path))

    def data_received(self, data: bytes) -> None:
        self._parser.feed_data(data)

    def connection_lost(self, exc: Exception | None) -> None:
        if not self.opened.done():
            self.opened.set_exception(ServiceGone())

    def on_headers_complete(self) -> None:
        """The stream is open: whatever happens from now on comes."""
        if not self.opened.done():
            self.opened.set_result(self._parser.get_status_code())

    def on_body(self, body: bytes) -> None:
        """Cut the stream into events."""
        *frames, self._rest = (self._rest + body).split(b"\n\n")
        for frame in frames:
            self._on_event(frame)

    def close(self) -> None:
        """Close it."""
        if self._transport is not None:
            self._transport.close()


def address(url: str) -> tuple[str, int]:
    """Return host and port of a URL."""
    parts = urlsplit(url)
    return parts.hostname or "127.0.0.1", parts.port or 80


async def connect(url: str) -> Connection:
    """Return a new connection."""
    _, connection = await asyncio.get_running_loop().create_connection(Connection, *address(url))
    return connection


async def follow(url: str, on_event: Callable[[bytes], None], path: str = "/api/v1/events") -> EventStream:
    """Return an open event stream."""
    host, port = address(url)
    loop = asyncio.get_running_loop()
    _, stream = await loop.create_connection(lambda: EventStream(path, on_event), host, port)
    async with asyncio.timeout(ANSWER_S):
        status = await stream.opened
    if status != 200:
        raise RuntimeError(f"GET {path}: {status}")
    return stream
