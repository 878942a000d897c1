"""This computer's network, as tests that run side by side share it: browsers need it still, cables change it.

When an interface comes or goes, Chromium gives up what it is just about to fetch (ERR_NETWORK_CHANGED), a
page or a script of it, from this computer as well; and no switch tells it otherwise.
"""

from __future__ import annotations

import fcntl
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
