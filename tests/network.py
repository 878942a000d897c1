"""This computer's network, as tests that run side by side share it: browsers need it still, cables change it,
and a port that is to be free in a moment must not be somebody else's by then.

When an interface comes or goes, Chromium gives up what it is just about to fetch (ERR_NETWORK_CHANGED), a
page or a script of it, from this computer as well; and no switch tells it otherwise.
"""

from __future__ import annotations

import fcntl
import socket
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

NETWORK, NEXT = Path(__file__), Path(__file__).with_name("other_computer.py")
"""Locks of this checkout: of the network, and of whoever gets it next: pages cannot keep it for ever."""


def still() -> AbstractContextManager[None]:
    """Nobody changes the network meanwhile; many may want that at a time, but none who changes it."""
    return _held(fcntl.LOCK_SH)


def changing() -> AbstractContextManager[None]:
    """Nobody needs it to be still meanwhile."""
    return _held(fcntl.LOCK_EX)


@contextmanager
def _held(how: int) -> Iterator[None]:
    with NETWORK.open() as network:
        with NEXT.open() as next_one:
            fcntl.flock(next_one, fcntl.LOCK_EX)
            fcntl.flock(network, how)
        yield


_PORTS: list[socket.socket] = []


def own_port(host: str = "127.0.0.1") -> int:
    """Return a port that the system gives to nobody else while this process lives. Whoever listens with
    SO_REUSEADDR, as servers do, may: nobody listens here.
    """
    held = socket.socket()
    held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    held.bind((host, 0))
    _PORTS.append(held)
    return int(held.getsockname()[1])
