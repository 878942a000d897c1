"""Confidence intervals at 95%: shares, rates of rare events, and anything else by bootstrap."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from typing import TypeVar

Z = 1.959963984540054
RESAMPLES = 1000

Interval = tuple[float, float]
T = TypeVar("T")


def wilson(successes: int, count: int) -> Interval:
    """Return Wilson's interval of a share."""
    if count == 0:
        return 0.0, 1.0
    share, z2 = successes / count, Z * Z
    centre = (share + z2 / (2 * count)) / (1 + z2 / count)
    half = Z / (1 + z2 / count) * math.sqrt(share * (1 - share) / count + z2 / (4 * count * count))
    low = 0.0 if successes == 0 else max(0.0, centre - half)
    high = 1.0 if successes == count else min(1.0, centre + half)
    return low, high


def poisson(events: int) -> Interval:
    """Return the interval of a count's expectation, by Byar's approximation: off by 2%, or 0.02, at most."""

    def bound(count: int, z: float) -> float:
        return float(count * (1 - 1 / (9 * count) + z / (3 * math.sqrt(count))) ** 3)

    return (bound(events, -Z) if events else 0.0), bound(events + 1, Z)


def bootstrap(values: Sequence[T], figure: Callable[[Sequence[T]], float]) -> Interval:
    """Return the percentile interval of a figure over resampled values (trials: acts stay joined)."""
    if not values:
        return math.nan, math.nan
    chance = random.Random(f"bootstrap {len(values)}")
    found = sorted(figure(chance.choices(values, k=len(values))) for _ in range(RESAMPLES))
    return found[int(0.025 * RESAMPLES)], found[min(RESAMPLES - 1, int(0.975 * RESAMPLES))]


def quantile(values: Sequence[float], share: float) -> float:
    """Return the smallest value that at least `share` of all do not exceed; NaN for none."""
    if not values:
        return math.nan
    ordered = sorted(values)
    return ordered[max(0, math.ceil(share * len(ordered)) - 1)]
