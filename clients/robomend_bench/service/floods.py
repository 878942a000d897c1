"""What one connection without a key takes: memory of the service, and how long it stays.

Each flood sends one kind of thing without end on one connection, as fast as the service reads it, and comes
back as soon as it is thrown out.
"""

from __future__ import annotations

import contextlib
import socket
import time
from dataclasses import dataclass

from robomend_bench.service.measure import memory_mb
from robomend_bench.service.process import Served
from robomend_bench.service.wire import address

HOST = b"Host: localhost\r\n"
POST = b"POST /api/v1/robots/r1/observations HTTP/1.1\r\n" + HOST
CHUNKED = POST + b"Content-Type: application/json\r\nTransfer-Encoding: chunked\r\n\r\n"

FIRST_S = 0.5
"""For what is paid once, for code and buffers: every kind has been there before it is measured."""

FLOODS: dict[str, tuple[bytes, bytes]] = {
    "trailers": (CHUNKED + b"0\r\n", b"X-Filler: " + b"a" * 50_000 + b"\r\n"),
    "a head that does not end": (b"GET / HTTP/1.1\r\n" + HOST, b"X-Filler: " + b"a" * 50_000 + b"\r\n"),
    "a header that does not end": (b"GET / HTTP/1.1\r\n" + HOST + b"X: ", b"a" * 50_000),
    "chunk extensions": (CHUNKED + b"5;", b"a=" + b"b" * 50_000 + b";"),
    "a body after its answer": (CHUNKED, b"c350\r\n" + b"a" * 50_000 + b"\r\n"),
    "requests in a row": (b"", (b"GET /version-info HTTP/1.1\r\n" + HOST + b"\r\n") * 1_000),
    "a sign-in": (
        b"POST /api/v1/session HTTP/1.1\r\n" + HOST + b"Content-Type: application/json\r\n"
        b"Content-Length: 100000000\r\n\r\n",
        b" " * 50_000,
    ),
}
"""Name -> how it begins, and what is repeated."""


@dataclass(frozen=True, slots=True)
class FloodResult:
    """What one kind came to."""

    sent_mb: float
    grown_mb: float  # the most that the service's memory grew while it went on
    longest_s: float  # that one connection lived


def run_floods(process: Served, seconds: float) -> dict[str, FloodResult]:
    """Send each flood for a while."""
    for begin, more in FLOODS.values():
        _flood(process, begin, more, FIRST_S)
    return {name: _flood(process, begin, more, seconds) for name, (begin, more) in FLOODS.items()}


def drip(url: str, pause_s: float, most_s: float) -> float:
    """Send a body a byte at a time; return how long the connection lived, at most `most_s`."""
    begun = time.monotonic()
    with _connected(url) as connection:
        connection.sendall(POST + b"Content-Length: 1000000\r\n\r\n")
        with contextlib.suppress(OSError):
            while time.monotonic() - begun < most_s:
                connection.sendall(b" ")
                time.sleep(pause_s)
    return time.monotonic() - begun


def _connected(url: str) -> socket.socket:
    return socket.create_connection(address(url), timeout=2.0)


def _flood(process: Served, begin: bytes, more: bytes, seconds: float) -> FloodResult:
    before = most = memory_mb(process.pid)
    sent, longest_s = 0, 0.0
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        begun = time.monotonic()
        with contextlib.suppress(OSError), _connected(process.url) as connection:
            connection.sendall(begin)
            while time.monotonic() < until:
                connection.sendall(more)
                sent += len(more)
                most = max(most, memory_mb(process.pid))
        longest_s = max(longest_s, time.monotonic() - begun)
        most = max(most, memory_mb(process.pid))
    return FloodResult(round(sent / 1e6, 1), round(most - before, 2), round(longest_s, 1))
