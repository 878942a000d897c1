"""A clock for stamps: the computer's, except that it does not go back by itself.

Observations are ordered by their stamps. Were the computer's clock set back by an hour, everything stamped
since would count as older than what was there before, and be ignored for an hour. This one goes on from where
it was instead.
"""

from __future__ import annotations

import time


class Clock:
    """See the module. It is at least the computer's clock, and at least as far on as time has passed."""

    def __init__(self) -> None:
        self._latest_ns = time.time_ns()
        self._read_at = time.monotonic_ns()

    def now_ns(self) -> int:
        """Return nanoseconds since the epoch."""
        # In this order: held up between the two, it would go ahead by that, and stay there.
        now_ns, at = time.time_ns(), time.monotonic_ns()
        on_ns = self._latest_ns + at - self._read_at
        self._latest_ns = now_ns = now_ns if now_ns > on_ns else on_ns
        self._read_at = at
        return now_ns

    @property
    def ahead_ns(self) -> int:
        """How far it is ahead of the computer's clock, as that went back."""
        return self.now_ns() - time.time_ns()

    def no_earlier_than(self, time_ns: int) -> None:
        """Go on from this time if it is ahead."""
        self._latest_ns = max(self.now_ns(), time_ns)

    def follow(self) -> None:
        """Go on from the computer's clock, also if that is back."""
        self._latest_ns = time.time_ns()
        self._read_at = time.monotonic_ns()
