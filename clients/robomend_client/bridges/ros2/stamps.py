"""How long ago a sample was made: its writer's stamps, whatever the writer's clock says.

Readers are looked at every few milliseconds, so the time of arrival is too coarse for a rate. A stamp's
distance from our clock is never less than the two clocks' difference; the least one seen stands for it.
"""

from __future__ import annotations

MOST_LATE_NS = 100_000_000
"""What is later than that is new to us now: a clock was set, or nobody looked."""

DRIFT = 1000
"""Clocks drift apart by less than one part in so many."""


class Ages:
    """Of the samples of one writer."""

    def __init__(self) -> None:
        self._least_ns: int | None = None
        self._at_ns = 0

    def age_ns(self, stamp_ns: int, now_ns: int) -> int:
        """Return how long before `now_ns` a sample with this stamp was made."""
        distance = now_ns - stamp_ns
        least = self._least_ns
        if least is not None:
            least += max(0, now_ns - self._at_ns) // DRIFT
        if least is None or not 0 <= distance - least <= MOST_LATE_NS:
            least = distance
        self._least_ns, self._at_ns = least, now_ns
        return distance - least
