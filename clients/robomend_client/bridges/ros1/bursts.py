"""Connections whose messages come in bursts, read together: a node publishes its topics one after the other.

    something came on any        ──► waits until `read` (each beat) ──► all that have something are read
    it hung up; it is to be read
    as it comes                  ──► is read at once

Being woken for each message by itself costs more than all that is done with it. What is read as it comes is a
connection that is new, that is in the middle of a message, or that sends large ones, so that nobody who sends
much ever waits for us. When something came is what the kernel says, so that neither the wait nor our own
lateness is in it.
"""

from __future__ import annotations

import asyncio
import select
import socket
import struct
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Protocol

AT_ONCE = 256
"""Connections that are read, of those that do not wait for the beat, before others have their turn."""

READ_BYTES = 256 * 1024

READS = 16
"""Of one connection, before others have their turn."""

SO_TIMESTAMPNS = 35
"""Linux; the module socket does not have it."""

STAMP = struct.Struct("@ll")
ABOUT_BYTES = socket.CMSG_SPACE(STAMP.size)

HUNG_UP = select.EPOLLRDHUP | select.EPOLLHUP | select.EPOLLERR
AS_IT_COMES = HUNG_UP | select.EPOLLIN


class Reader(Protocol):
    """One connection, as what is read of it is told."""

    def received(self, data: memoryview, after_ns: int, arrived_ns: int) -> bool:
        """Take in bytes, which are another's after that; return whether to read on as they come.

        Args:
            after_ns: before that, nothing of it was there.
            arrived_ns: when the last of it came.
        """

    def ended(self, error: Exception | None) -> None:
        """Nothing comes any more, and `leave` was done. None: the other side has closed it."""


class _Joined:
    """One connection."""

    __slots__ = ("as_it_comes", "reader", "wire")

    def __init__(self, wire: socket.socket, reader: Reader) -> None:
        self.wire = wire
        self.reader = reader
        self.as_it_comes = True  # what begins shall not wait


class Bursts:
    """All connections of one node of ours."""

    def __init__(self, now_ns: Callable[[], int] = time.time_ns) -> None:
        """`now_ns` is the clock by which readers are told when something came."""
        self._now_ns = now_ns
        self._any = select.epoll()
        self._at_once = select.epoll()
        self._joined: dict[int, _Joined] = {}
        self._looked_ns = time.monotonic_ns()  # when there was nothing left of what had come
        self._buffer = bytearray(READ_BYTES)  # one for all: memory of that size is not to be had for nothing
        self._view = memoryview(self._buffer)

    def join(self, wire: socket.socket, reader: Reader) -> None:
        """Read this connection, too; it does not block."""
        if not self._joined:
            asyncio.get_running_loop().add_reader(self._at_once.fileno(), self._read_at_once)
        with suppress(OSError):  # without it, what comes is as old as our reading it
            wire.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self._joined[wire.fileno()] = _Joined(wire, reader)
        self._any.register(wire.fileno(), select.EPOLLIN)
        self._at_once.register(wire.fileno(), AS_IT_COMES)

    def leave(self, wire: socket.socket) -> None:
        """Read it no more, before it is closed; it may have left before."""
        number = wire.fileno()
        if self._joined.pop(number, None) is None:
            return
        self._any.unregister(number)
        self._at_once.unregister(number)
        if not self._joined:
            asyncio.get_running_loop().remove_reader(self._at_once.fileno())

    def close(self) -> None:
        """All have left."""
        for joined in tuple(self._joined.values()):
            self.leave(joined.wire)
        self._any.close()
        self._at_once.close()

    def read(self) -> None:
        """Read all that has come by now."""
        if not self._joined:
            return
        before_ns, self._looked_ns = self._looked_ns, time.monotonic_ns()
        self._read_all(self._any.poll(0, len(self._joined)), self._looked_ns - before_ns)

    # --- inside ----------------------------------------------------------------------------------------

    def _read_at_once(self) -> None:
        ready = self._at_once.poll(0, AT_ONCE)
        if any(event & HUNG_UP for _, event in ready):
            self.read()  # what it has said on others before it hung up must not count as said since
        else:
            self._read_all(ready, time.monotonic_ns() - self._looked_ns)

    def _read_all(self, ready: Iterable[tuple[int, int]], since_ns: int) -> None:
        """Read these, of which everything came within the last so many nanoseconds."""
        wall_ns, now_ns = time.time_ns(), self._now_ns()
        for number, _ in ready:
            joined = self._joined.get(number)
            if joined is not None:  # or one that was read before has sent this one away
                self._read(number, joined, since_ns, wall_ns, now_ns)

    def _read(self, number: int, joined: _Joined, since_ns: int, wall_ns: int, now_ns: int) -> None:
        wire, reader, as_it_comes = joined.wire, joined.reader, joined.as_it_comes
        try:
            for _ in range(READS):
                size, about, _, _ = wire.recvmsg_into((self._buffer,), ABOUT_BYTES)
                if not size:
                    self.leave(wire)
                    reader.ended(None)
                    return
                age_ns = _age_ns(about, since_ns, wall_ns)
                as_it_comes = reader.received(self._view[:size], now_ns - since_ns, now_ns - age_ns)
                if size < READ_BYTES:
                    break
        except (BlockingIOError, InterruptedError):
            pass
        except Exception as error:  # noqa: BLE001  # one connection's, and told by who reads it
            self.leave(wire)
            reader.ended(error)
            return
        if as_it_comes is not joined.as_it_comes and self._joined.get(number) is joined:
            joined.as_it_comes = as_it_comes
            self._at_once.modify(number, AS_IT_COMES if as_it_comes else HUNG_UP)


def _age_ns(about: Iterable[tuple[int, int, bytes]], oldest_ns: int, now_ns: int) -> int:
    """Return how long ago bytes came; 0 if the computer's clock was set meanwhile, or it is not told.

    Args:
        now_ns: by the computer's clock.
    """
    for level, kind, value in about:
        if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS and len(value) == STAMP.size:
            seconds, nanoseconds = STAMP.unpack(value)
            age_ns = now_ns - (int(seconds) * 1_000_000_000 + int(nanoseconds))
            if 0 <= age_ns <= oldest_ns:
                return age_ns
    return 0
