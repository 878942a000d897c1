"""Values of different topics whose trends are alike: what odometry and gyroscope say of one turn.

The values are taken at ticks, two are compared where both are known. Alike are those of a high correlation
that both move. The observer itself, in each of its ways of comparing (trends, or signs) and with several b,
is run over them: where it counts the fewest mismatches, it is taken, and what it counted in healthy logs
says which count is still a match.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from robomend_batch.learn.gathering import TICK_NS, Series
from robomend_batch.learn.stretches import Stretch
from robomend_client.observers.base import SECOND
from robomend_client.observers.binary_qualitative import BinaryQualitativeObserver, Match

LEAST_TICKS = 300
LEAST_CORRELATION = 0.9
SHARES = (0.3, 0.5, 0.7, 0.85)
"""Of the ticks that count as standing still: b is so large."""

MOST_COUNT = 100_000
MOST_MATCHES = 10
MOST_SERIES = 100
WINDOW = 5
"""Ticks of a line."""

WAYS = ("trend-trend", "sign-sign")
LONGEST_MISMATCH = 25
"""Ticks; who disagrees for longer is not alike: twice that is what a robot would not notice."""

FEW = 5
"""Mismatches that are no reason to look away from more of the ticks."""

LEAST_THRESHOLD = 10
"""Ticks: a value that pauses for a window, and the window until its trend is right again."""

Ticks = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MatchFound:
    """Two values that are alike."""

    first: str  # TOPIC:FIELD
    second: str
    compare: str
    slope: float
    second_slope: float
    threshold: int
    correlation: float
    ticks: int
    moving: float  # share of ticks in which either moves
    longest: int  # count of mismatches, at most


def learn_matches(
    series: Mapping[str, Series], node_of: Mapping[str, str], stretches: Sequence[Stretch]
) -> list[MatchFound]:
    """Return the pairs of values that are alike, at most one of two topics.

    Args:
        series: TOPIC:FIELD -> its values.
        node_of: topic -> the node that publishes it; values of one node say nothing about each other.
        stretches: that are learned from.
    """
    lines = {name: _ticks(one, stretches) for name, one in sorted(series.items())[:MOST_SERIES]}
    best: dict[tuple[str, str], MatchFound] = {}
    for first, second in combinations(lines, 2):
        topics = first.split(":")[0], second.split(":")[0]
        if node_of[topics[0]] == node_of[topics[1]]:
            continue
        found = _match(first, lines[first], second, lines[second])
        if found is not None and (topics not in best or found.correlation > best[topics].correlation):
            best[topics] = found
    return sorted(best.values(), key=lambda one: (-one.correlation, one.first, one.second))[:MOST_MATCHES]


def _ticks(series: Series, stretches: Sequence[Stretch]) -> dict[int, Ticks]:
    """Return the values at the ticks of each stretch, by its number; NaN where there is none."""
    found = {}
    for number, stretch in enumerate(stretches):
        first = stretch.start_ns // TICK_NS
        for times, values in series.pieces([stretch]):
            line = np.full(stretch.end_ns // TICK_NS - first + 1, np.nan)
            line[times // TICK_NS - first] = values
            found[number] = line
    return found


def _match(first: str, one: dict[int, Ticks], second: str, other: dict[int, Ticks]) -> MatchFound | None:
    pairs = [(one[number], other[number]) for number in one if number in other]
    pairs = [(a, b) for a, b in pairs if (np.isfinite(a) & np.isfinite(b)).sum() > 2 * WINDOW]
    if not pairs:
        return None
    a, b = (np.concatenate(side) for side in zip(*pairs, strict=True))
    both = np.isfinite(a) & np.isfinite(b)
    if both.sum() < LEAST_TICKS or min(a[both].std(), b[both].std()) < 1e-9:
        return None
    correlation = float(np.corrcoef(a[both], b[both])[0, 1])
    if correlation < LEAST_CORRELATION:
        return None
    tried = []
    for compare in WAYS:
        sizes = [_sizes(side, pairs, compare) for side in (0, 1)]
        for share in SHARES:
            limits = float(np.quantile(sizes[0], share)), float(np.quantile(sizes[1], share))
            if min(limits) > 0:
                match = Match(slope=limits[0], second_slope=limits[1], compare=compare, threshold=MOST_COUNT)
                longest = max(_longest(match, x, y) for x, y in pairs)
                tried.append((max(longest, FEW), share, compare, limits, longest))
    if not tried:
        return None
    _, share, compare, (slope, second_slope), longest = min(tried)
    if longest > LONGEST_MISMATCH:
        return None
    return MatchFound(
        first,
        second,
        compare,
        slope,
        second_slope,
        2 * longest + LEAST_THRESHOLD,
        correlation,
        int(both.sum()),
        1 - share,
        longest,
    )


def _sizes(side: int, pairs: Sequence[tuple[Ticks, Ticks]], compare: str) -> Ticks:
    """Return how large the values of one side are, or their slopes, without sign."""
    lines = [pair[side] for pair in pairs]
    sizes = np.abs(np.concatenate([_slopes(line) if compare == WAYS[0] else line for line in lines]))
    known = sizes[np.isfinite(sizes)]
    return known if len(known) else np.zeros(1)


def _slopes(line: Ticks) -> Ticks:
    """Return the slope of the line through the newest ticks, at each tick, per second."""
    slopes = np.full(len(line), np.nan)
    if len(line) >= WINDOW:
        steps = np.arange(WINDOW) - (WINDOW - 1) / 2
        views = np.lib.stride_tricks.sliding_window_view(line, WINDOW)
        slopes[WINDOW - 1 :] = views @ steps / (steps @ steps) / (TICK_NS / SECOND)
    return slopes


def _longest(match: Match, first: Ticks, second: Ticks) -> int:
    """Return how far the observer's count goes."""
    observer = BinaryQualitativeObserver("matched(first,second)", "first", "second", match)
    longest = 0
    for tick, (a, b) in enumerate(zip(first.tolist(), second.tolist(), strict=True)):
        time_ns = tick * TICK_NS + TICK_NS // 2
        for source, value in (("first", a), ("second", b)):
            if value == value:  # a tick without a value is NaN
                observer.feed(source, time_ns, value)
        longest = max(longest, observer.mismatch or 0)
    return longest
