"""Connections whose messages come in bursts, read together: a node publishes its topics one after the other.

    any of them readable ──► REST_S ──► all that are readable are read ──► again

Being woken for each message by itself costs more than all that is done with it. One that is in the middle of
a message is read at once, so that nobody who sends much ever waits for us. When something came is what the
kernel says, so that neither the rest nor our own lateness is in it.
"""

from __future__ import annotations

import asyncio
import select
import socket
import struct
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import Protocol

REST_S = 0.02
"""What the bursts of several nodes are gathered for; a message is taken in that much later at most."""

AT_ONCE = 256
"""Connections that are read before others have their turn."""

READ_BYTES = 256 * 1024

SO_TIMESTAMPNS = 35
"""Linux; the module socket does not have it."""

STAMP = struct.Struct("@ll")
ABOUT_BYTES = socket.CMSG_SPACE(STAMP.size)


class Reader(Protocol):
    """One connection, as what is read of it is told."""

    def received(self, data: bytes, arrived_ns: int) -> bool:
        """Take in bytes, the last of which came then; return whether more of the same message is to come."""

    def ended(self, error: Exception | None) -> None:
        """Nothing comes any more, and `leave` was done. None: the other side has closed it."""


class Bursts:
    """All connections of one node of ours."""

    def __init__(self) -> None:
        self._epoll = select.epoll()
        self._joined: dict[int, tuple[socket.socket, Reader]] = {}
        self._within: set[int] = set()  # in the middle of a message
        self._rest: asyncio.TimerHandle | None = None
        self._read_ns = time.monotonic_ns()

    def join(self, wire: socket.socket, reader: Reader) -> None:
        """Read this connection, too; it does not block."""
        if not self._joined:
            self._watch()
        with suppress(OSError):  # without it, what comes is as old as our reading it
            wire.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self._joined[wire.fileno()] = (wire, reader)
        self._epoll.register(wire.fileno(), select.EPOLLIN)

    def leave(self, wire: socket.socket) -> None:
        """Read it no more, before it is closed; it may have left before."""
        number = wire.fileno()
        if self._joined.pop(number, None) is None:
            return
        self._epoll.unregister(number)
        self._within.discard(number)
        if not self._joined:
            self._unwatch()

    def close(self) -> None:
        """All have left."""
        for wire, _ in tuple(self._joined.values()):
            self.leave(wire)
        self._epoll.close()

    # --- reading ---------------------------------------------------------------------------------------

    def _watch(self) -> None:
        self._rest = None
        asyncio.get_running_loop().add_reader(self._epoll.fileno(), self._ready)

    def _unwatch(self) -> None:
        asyncio.get_running_loop().remove_reader(self._epoll.fileno())
        if self._rest is not None:
            self._rest.cancel()

    def _ready(self) -> None:
        if self._within:
            self._read()
            return
        loop = asyncio.get_running_loop()
        loop.remove_reader(self._epoll.fileno())
        self._rest = loop.call_later(REST_S, self._after_rest)

    def _after_rest(self) -> None:
        self._watch()
        self._read()

    def _read(self) -> None:
        now_ns, before_ns, self._read_ns = time.time_ns(), self._read_ns, time.monotonic_ns()
        oldest_ns = now_ns - (self._read_ns - before_ns)
        for number, wire, reader in self._readable():
            try:
                data, about, _, _ = wire.recvmsg(READ_BYTES, ABOUT_BYTES)
                within = bool(data) and reader.received(data, _arrived_ns(about, oldest_ns, now_ns))
            except (BlockingIOError, InterruptedError):
                continue
            except Exception as error:  # noqa: BLE001  # one connection's, and told by who reads it
                self.leave(wire)
                reader.ended(error)
                continue
            if not data:
                self.leave(wire)
                reader.ended(None)
            elif number in self._joined:
                (self._within.add if within else self._within.discard)(number)

    def _readable(self) -> Iterator[tuple[int, socket.socket, Reader]]:
        for number, _ in self._epoll.poll(0, AT_ONCE):
            joined = self._joined.get(number)  # one that was read before may have sent this one away
            if joined is not None:
                yield number, *joined


def _arrived_ns(about: Iterable[tuple[int, int, bytes]], oldest_ns: int, now_ns: int) -> int:
    """Return when bytes came, by the computer's clock; now, if that was set meanwhile, or it is not told."""
    for level, kind, value in about:
        if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS and len(value) == STAMP.size:
            seconds, nanoseconds = STAMP.unpack(value)
            arrived_ns = int(seconds) * 1_000_000_000 + int(nanoseconds)
            if oldest_ns <= arrived_ns <= now_ns:
                return arrived_ns
    return now_ns
