"""The clock by which OBS is ordered and grows stale: the computer's, except that it never goes back.

OBS orders literals by their stamps. If the computer's clock were set back by an hour, everything stamped
since would count as older than what was there before, and be ignored for an hour. This one goes on from where
it was instead. After a restart it begins no earlier than what a robot's OBS holds.
"""

from __future__ import annotations

import time


class Clock:
    """See the module."""

    def __init__(self) -> None:
        self._latest_ns = time.time_ns()
        self._read_at = time.monotonic_ns()

    def now_ns(self) -> int:
        """Return the time in nanoseconds since the epoch."""
        at = time.monotonic_ns()
        self._latest_ns = max(time.time_ns(), self._latest_ns + at - self._read_at)
        self._read_at = at
        return self._latest_ns

    def no_earlier_than(self, time_ns: int) -> None:
        """Go on from this time if it is ahead."""
        self._latest_ns = max(self.now_ns(), time_ns)


CLOCK = Clock()
"""Of the process, as the computer's is."""
