"""Which stretches of the logs are learned from, and which are held back."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robomend_client.observers.base import SECOND

Times = NDArray[np.int64]

EVERY = 4
"""One of so many is held back."""

LEAST_S, MOST_S = 15.0, 600.0
PIECES = 12
"""Stretches that the logs are cut into, if they are neither too short nor too long for that."""

HOUR = 3600 * SECOND


@dataclass(frozen=True, slots=True)
class Stretch:
    """A part of a log."""

    log: int
    start_ns: int
    end_ns: int
    held_back: bool

    def of(self, times_ns: Times) -> slice:
        """Return which of the sorted times are in it."""
        first, last = np.searchsorted(times_ns, (self.start_ns, self.end_ns))
        return slice(int(first), int(last))


def cut(spans_ns: Sequence[tuple[int, int]]) -> list[Stretch]:
    """Return the stretches of logs, of which each has a beginning and an end.

    They are numbered through all logs, and the last of each EVERY is held back: of one long log some of its
    parts, of many short ones some of the logs.
    """
    total_s = sum(end - start for start, end in spans_ns) / SECOND
    most_ns = round(min(max(total_s / PIECES, LEAST_S), MOST_S) * SECOND)
    found: list[Stretch] = []
    for log, (start_ns, end_ns) in enumerate(spans_ns):
        count = max(1, -(-(end_ns - start_ns) // most_ns))
        edges = [start_ns + (end_ns - start_ns) * number // count for number in range(count)]
        for begin, end in zip(edges, [*edges[1:], end_ns + 1], strict=True):
            found.append(Stretch(log, begin, end, len(found) % EVERY == EVERY - 1))
    return found


def hours(stretches: Iterable[Stretch]) -> float:
    """Return how long they are together."""
    return sum(one.end_ns - one.start_ns for one in stretches) / HOUR
