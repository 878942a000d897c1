"""Which faults of a topic can be told by whoever knows the recording without them alone.

    dropped    the fault lasts twice as long as the longest pause of the healthy part, at least
    thinned    no stretch of the healthy part that lasts a quarter of the fault has fewer than SCARCE of the
               messages that such stretches usually have: half of them might be missing by themselves there
    frozen     the fault lasts twice as long as the number stands still in the healthy part, at least
    ramped     the range of the first half of the healthy part, and as much again on either side, holds in its
               second half: else it is not the range of the number

And of what there is nothing nothing can be taken, or changed: without the fault, the topic has SCARCE of its
usual messages in the fault's time, at least.

Nothing here knows what was learned, or what an observer can do.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LONGER = 2.0
PARTS = 4
SCARCE = 0.6


def why_not(
    kind: str, times_s: Floats, numbers: Floats, fault_s: float, left_hz: float | None = None
) -> str | None:
    """Return why a fault cannot be told; None: it can.

    Args:
        kind: dropped, thinned, frozen or ramped.
        times_s: of the topic's messages in the healthy part, from its beginning to its end, sorted.
        numbers: of the field that is edited, one a message; none where nothing is.
        fault_s: how long it lasts.
        left_hz: messages a second that there are in its time without it; None: as usual.
    """
    usual_hz = (len(times_s) - 1) / float(np.ptp(times_s))
    if left_hz is not None and left_hz < SCARCE * usual_hz:
        return f"{left_hz / usual_hz:.0%} of the usual messages are there by themselves"
    if kind == "dropped":
        longest_s = float(np.diff(times_s).max(initial=0.0))
        return f"pauses of {longest_s:.1f} s" if LONGER * longest_s > fault_s else None
    if kind == "thinned":
        share = scarcest(times_s, fault_s / PARTS)
        return f"down to {share:.0%} of the usual messages" if share < SCARCE else None
    if kind == "frozen":
        still_s = longest_standstill(times_s, numbers)
        return f"stands still for {still_s:.1f} s" if LONGER * still_s > fault_s else None
    if kind == "ramped":
        first, second = np.array_split(numbers, 2)
        span = float(np.ptp(first))
        beyond = max(float(second.max() - first.max()), float(first.min() - second.min()))
        return "its range was not seen" if beyond > span else None
    return None


def scarcest(times_s: Floats, part_s: float) -> float:
    """Return how many messages the emptiest part of so long has, as a share of the usual one."""
    begins = np.arange(times_s[0], times_s[-1] - part_s, part_s / 10)
    if not len(begins):
        return 0.0
    counts = np.searchsorted(times_s, begins + part_s) - np.searchsorted(times_s, begins)
    usual = float(np.median(counts))
    return float(counts.min()) / usual if usual else 0.0


def longest_standstill(times_s: Floats, numbers: Floats) -> float:
    """Return how long a number stays what it is, at most, from its first message to the last one."""
    begins = np.flatnonzero(np.diff(numbers, prepend=np.nan) != 0)
    ends = np.append(begins[1:], len(numbers)) - 1
    return float((times_s[ends] - times_s[begins]).max(initial=0.0))
