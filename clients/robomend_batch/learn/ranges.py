"""What a device's own diagnostics say in healthy logs: its levels, and the range of each number; and the
ranges of what sensors of one number say, such as a thermometer.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robomend_batch.learn.gathering import Series, Status
from robomend_batch.learn.stretches import Stretch
from robomend_batch.learn.tails import HEAVIEST, LIGHTEST, Bound, bound, largest_of_blocks
from robomend_client.observers.base import SECOND
from robomend_client.observers.diagnostic import ERROR, STALE, WARN

LEAST_READINGS = 20
AGREEING = 3
"""Readings in a row, for a verdict: one reading that is off is none."""

BLOCKS = 200
DRIFT = 0.5
"""Of the range (of 98 %) of the first half of what was seen: what leaves it by more later has none."""

TELEMETRY = frozenset(
    f"{package}/msg/{name}"
    for package, names in {
        "std_msgs": ("Float32", "Float64"),
        "sensor_msgs": ("BatteryState", "FluidPressure", "Illuminance", "RelativeHumidity", "Temperature"),
    }.items()
    for name in names
)
"""Types whose numbers have a range; a pose or a speed goes wherever the robot goes."""

MARGIN = 0.25
"""Of the range that was seen, on either side at least: a device that was cold may get warm."""


@dataclass(frozen=True, slots=True)
class RangeFound:
    """A number of a status."""

    key: str
    low: Bound | None  # None: it is not judged from below
    high: Bound
    least: float
    largest: float


@dataclass(frozen=True, slots=True)
class StatusFound:
    """What was learned of a status."""

    name: str
    publishers: tuple[str, ...]
    bad_from: str  # warn or error
    levels: dict[int, int]
    interval_s: float
    lifetime_s: float
    ranges: tuple[RangeFound, ...]
    left_out: tuple[str, ...]  # keys, and why they are not judged


def learn_status(
    name: str, status: Status, stretches: Sequence[Stretch], hours: float, per_hour: float
) -> StatusFound | str:
    """Return what a status says when the robot is healthy, or why that cannot be said."""
    heard = status.levels.pieces(stretches)
    counts = Counter(int(level) for _, values in heard for level in values.tolist())
    levels = {level: count for level, count in sorted(counts.items()) if level != STALE}
    if not levels:
        return "it is stale all the time"
    if levels.get(ERROR, 0) > 0:
        return f"{levels[ERROR]} errors in logs that should be healthy"
    # Two of one name in one message are one reading: the worst of them counts.
    gaps_ns = [np.diff(np.unique(times)).astype(np.float64) for times, _ in heard]
    gaps = np.concatenate(gaps_ns or [np.zeros(0)]) / SECOND
    if len(gaps) < LEAST_READINGS:
        return f"{len(gaps)} readings: too few"
    ranges, left_out = [], []
    for key, series in sorted(status.numbers.items()):
        found = learn_range(key, series, stretches, hours, per_hour)
        if isinstance(found, str):
            left_out.append(f"{key}: {found}")
        else:
            ranges.append(found)
    return StatusFound(
        name,
        tuple(sorted(status.publishers)),
        "error" if levels.get(WARN, 0) else "warn",
        levels,
        float(np.median(gaps)),
        max(5.0, 2 * float(gaps.max())),
        tuple(ranges),
        tuple(left_out),
    )


def learn_range(
    key: str,
    series: Series,
    stretches: Sequence[Stretch],
    hours: float,
    per_hour: float,
    telemetry: bool = False,
) -> RangeFound | str:
    """Return the range of a number, or why it has none.

    Args:
        telemetry: it is a topic's, not a device's diagnosis of itself: what drifts has no range, and tails
            are taken to be light.
    """
    pieces = [values for _, values in series.pieces(stretches) if len(values) >= AGREEING]
    values = np.concatenate(pieces) if pieces else np.zeros(0)
    if len(values) < LEAST_READINGS:
        return f"{len(values)} numbers: too few"
    least, largest = float(values.min()), float(values.max())
    if least == largest:
        return f"always {least:g}"
    steps = np.concatenate([np.diff(piece) for piece in pieces])
    moves = steps[steps != 0]
    if len(moves) and ((moves > 0).all() or (moves < 0).all()):
        return "it counts: no range"
    (low1, high1), (low2, high2) = (np.quantile(half, (0.01, 0.99)) for half in np.array_split(values, 2))
    if telemetry and max(high2 - high1, low1 - low2) > DRIFT * (high1 - low1):
        return "it drifts: no range"
    margin = MARGIN * (largest - least)
    heaviest = LIGHTEST if telemetry else HEAVIEST

    def edge(sign: int) -> Bound:
        agreed = [_agreed(sign * piece) for piece in pieces]
        blocks = np.concatenate([largest_of_blocks(one, max(1, len(values) // BLOCKS)) for one in agreed])
        found = bound(blocks, hours, per_hour / 2, float(np.median(sign * values)), heaviest)
        seen = float((sign * values).max())
        return Bound(max(found.value, seen + margin), found.usual, found.quantile, seen, len(values))

    low, high = edge(-1), edge(1)
    useless = least >= 0 and -low.value <= 0  # a number that is never negative is judged from above only
    return RangeFound(key, None if useless else low, high, least, largest)


def _agreed(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return, for each AGREEING readings in a row, the least of them."""
    return np.asarray(np.lib.stride_tricks.sliding_window_view(values, AGREEING).min(axis=1))
