"""The end of a thread that looks at something again and again, and sleeps in between.

`threading.Event` makes a lock and a queue for each wait: many times a second, that costs more than the look.
"""

from __future__ import annotations

import threading


class EndSign:
    """An event for one thread that waits."""

    __slots__ = ("_come", "_lock")

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._lock.acquire()
        self._come = False

    def wait(self, timeout_s: float) -> bool:
        """Return whether the end has come; after so long at most."""
        return self._come or self._lock.acquire(timeout=timeout_s)

    def is_set(self) -> bool:
        """Return whether it has come."""
        return self._come

    def set(self) -> None:
        """It comes."""
        if not self._come:
            self._come = True
            self._lock.release()
