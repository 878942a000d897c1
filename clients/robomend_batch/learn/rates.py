"""The rate of a topic: what it is, how far it strays in healthy logs, how long the topic is silent.

A pause that silence lets pass, the rate must let pass, too, and the burst of what was held up after it, even
if the logs show none: in a window that lasts S a pause of P makes S + P of it, and S − P later. The window is
the smallest in which a healthy rate nevertheless stays above SLOWEST of itself, so that half of the
messages missing shows.

Where pauses are too long for that, or the logs too short, the rate is that beside them: an interval counts as
so long at most (`pause_s`), and what is longer is left to silence:

    |  |  |  |              |||||  |  |         intervals, and a pause
    |  |  |  |      |||||  |  |                 as they count

What is left are sums of bounded intervals. These have light tails (by the central limit theorem, and
Bernstein's inequality), so that a few windows tell how far another one can stray: a prediction interval, as
of a normal mean whose variance is estimated. It is estimated from parts of the windows, of which there are
more: a window of PARTS parts that have nothing to do with each other strays √PARTS times as far as one, and
what windows were seen to stray is the least that is believed. Only that half is missing is told from it,
though: a bound that rests on half a minute is not drawn tighter than SLOWEST.

A topic for which that is too wide, too, is watched for little but silence, and one that comes irregularly is
not watched.

Source: G. Hahn, W. Meeker. Statistical Intervals. Wiley, 1991 (section 4.7: a prediction bound for a future
observation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from robomend.model.from_graph import IRREGULAR, LEAST_SPAN_S, LONGEST_SILENCE_S
from robomend_batch.learn.stretches import Times
from robomend_batch.learn.tails import HEAVIEST, Bound, bound, largest_of_blocks, predicted, spread_above
from robomend_client.observers.base import SECOND, ns
from robomend_client.observers.rate import LEAST_SILENCE_S

LEAST_MESSAGES = 60

WINDOWS = (10, 20, 40, 80, 160, 320, 640)
LONGEST_WINDOW_S = 60.0
LEAST_WINDOWS = 8
"""Windows that the logs must hold side by side."""

SLOWEST = 0.6
"""Of the rate: slower is no healthy one."""

PAUSES = (64, 32, 16, 8, 4)
"""Usual intervals that a pause is longer than."""

SUMS = (40, 48, 56, 64, 80, 96, 112, 128, 160, 192, 224, 256, 320, 384, 448, 512, 640)
LEAST_SUM_S = 0.7
"""Of a window whose length is taken to be normal: messages, and seconds, for bursts in it are few. A log of a
quarter of a minute may hold enough of one, and too few of its double.
"""

PARTS = 4
"""That a window is cut into."""

PAUSED = 10.0
"""Usual intervals: who saw no interval as long as that has seen no pause, only jitter."""

HEAVIEST_PAUSES = 0.4
"""ξ of pauses is no larger, once one was seen. The longest ones of the two halves of a recording differ by a
factor whose logarithm is logistic with scale ξ, if tails fall by a power: over 201 topics of 61 recordings of
real robots that is 0.4.
"""

Seconds = NDArray[np.float64]

WAYS = 2
"""In which an observer of a rate can raise a false alarm: silence, and a wrong rate."""


@dataclass(frozen=True, slots=True)
class RateFound:
    """What was learned of a topic."""

    topic: str
    rate_hz: float
    tolerance_hz: float
    above_hz: float
    window: int  # messages
    silence_s: float
    gaps: Bound  # seconds
    spans: Bound  # of windows, seconds
    fastest_hz: Bound
    messages: int
    only_silence: bool  # its rate strays so far that a wrong one cannot be told
    pause_s: float | None = None  # an interval counts as so long at most; None: as it is


def learn_rate(topic: str, pieces: Sequence[Times], hours: float, per_hour: float) -> RateFound | str:
    """Return the rate of a topic, or why there is none.

    Args:
        topic: its name.
        pieces: sorted times of its messages, stretch by stretch.
        hours: of all stretches.
        per_hour: false alarms, of each way.
    """
    messages = sum(map(len, pieces))
    gaps = [np.diff(times) / SECOND for times in pieces if len(times) > 1]
    if messages < LEAST_MESSAGES or not gaps:
        return f"{messages} messages: too few for a rate"
    if (span_s := float(sum(one.sum() for one in gaps))) < LEAST_SPAN_S:
        return f"{messages} messages within {span_s:.3g} s: too short for a rate"
    all_gaps = np.concatenate(gaps)
    usual_s = float(np.median(all_gaps))
    if usual_s <= 0:
        return "its messages come several at once"
    heaviest = HEAVIEST_PAUSES if all_gaps.max() > PAUSED * usual_s else HEAVIEST
    silence = bound(all_gaps, hours, per_hour, heaviest=heaviest)
    if silence.value > max(LONGEST_SILENCE_S, IRREGULAR * usual_s):
        return f"irregular: usually {usual_s:.3g} s apart, and up to {silence.largest:.3g} s"
    silence_s = max(silence.value, LEAST_SILENCE_S, 2.5 * usual_s)
    found: RateFound | None = None
    for window in WINDOWS:
        if window > WINDOWS[0] and window * usual_s > LONGEST_WINDOW_S:
            break
        tried = _of_window(topic, pieces, window, hours, per_hour, silence_s, silence, messages)
        if tried is None:
            break
        if found is None or tried.tolerance_hz / tried.rate_hz < found.tolerance_hz / found.rate_hz:
            found = tried
        if not found.only_silence:
            break
    if found is None:
        return f"{messages} messages: too few for a rate"
    return (_beside_pauses(found, pieces, hours, per_hour) or found) if found.only_silence else found


def _beside_pauses(
    found: RateFound, pieces: Sequence[Times], hours: float, per_hour: float
) -> RateFound | None:
    """Return what tells that half of the messages are missing beside pauses; None: nothing."""
    usual_s = 1 / found.rate_hz
    for window in SUMS:
        if window * usual_s < LEAST_SUM_S:
            continue
        if window > SUMS[0] and window * usual_s > LONGEST_WINDOW_S:
            break
        tried = []
        for intervals in PAUSES:
            pause_s = intervals * usual_s
            counted = [_counted(times, ns(pause_s)) for times in pieces]
            spans, part = _spans(counted, window), (window - 1) // PARTS + 1
            parts = _spans(counted, part)
            if spans is None or parts is None:
                return None
            all_spans = np.concatenate(spans)
            slow = predicted(
                all_spans,
                sum(len(one) // part for one in parts),
                per_hour / 2 * float(np.median(all_spans)) / 3600,
                ((window - 1) / (part - 1)) ** 0.5 * spread_above(np.concatenate(parts)),
            )
            tried.append((max(slow.value / slow.usual, 1 + pause_s / slow.usual), pause_s, slow, spans))
        slowest, pause_s, slow, spans = min(tried, key=lambda one: one[0])
        if slowest * SLOWEST > 1:
            continue
        rate_hz = (window - 1) / slow.usual
        fast = _fastest(spans, window, slow.usual, hours, per_hour)
        highest_hz = max(fast.value, (window - 1) / max(slow.usual - found.silence_s, slow.usual / 100))
        return replace(
            found,
            rate_hz=rate_hz,
            tolerance_hz=(1 - SLOWEST) * rate_hz,
            above_hz=max(highest_hz - rate_hz, rate_hz / 20),
            window=window,
            spans=slow,
            fastest_hz=fast,
            only_silence=False,
            pause_s=pause_s,
        )
    return None


def _counted(times: Times, pause_ns: int) -> Times:
    """Return times from which is left out what intervals are longer than a pause."""
    if not len(times):
        return times
    return np.concatenate([times[:1], times[0] + np.cumsum(np.minimum(np.diff(times), pause_ns))])


def _spans(pieces: Sequence[Times], window: int) -> list[Seconds] | None:
    """Return how long windows of so many messages last, stretch by stretch; None if there are too few."""
    intervals = window - 1
    spans = [(times[intervals:] - times[:-intervals]) / SECOND for times in pieces if len(times) > intervals]
    return spans if sum(-(-len(one) // window) for one in spans) >= LEAST_WINDOWS else None


def _fastest(spans: Sequence[Seconds], window: int, usual_s: float, hours: float, per_hour: float) -> Bound:
    rates = [(window - 1) / np.maximum(one, usual_s / 100) for one in spans]
    samples = np.concatenate([largest_of_blocks(one, window) for one in rates])
    return bound(samples, hours, per_hour / 2, (window - 1) / usual_s)


def _of_window(
    topic: str,
    pieces: Sequence[Times],
    window: int,
    hours: float,
    per_hour: float,
    silence_s: float,
    silence: Bound,
    messages: int,
) -> RateFound | None:
    """Return what a window of so many messages comes to; None if the logs hold too few of them."""
    intervals = window - 1
    spans = _spans(pieces, window)
    if spans is None:
        return None
    usual_s = float(np.median(np.concatenate(spans)))
    rate_hz = intervals / usual_s
    slow = bound(
        np.concatenate([largest_of_blocks(one, window) for one in spans]), hours, per_hour / 2, usual_s
    )
    fast = _fastest(spans, window, usual_s, hours, per_hour)
    lowest_hz = intervals / max(slow.value, usual_s + silence_s)
    highest_hz = max(fast.value, intervals / max(usual_s - silence_s, usual_s / 100))
    return RateFound(
        topic,
        rate_hz,
        max(rate_hz - lowest_hz, rate_hz / 20),
        max(highest_hz - rate_hz, rate_hz / 20),
        window,
        silence_s,
        silence,
        slow,
        fast,
        messages,
        lowest_hz < SLOWEST * rate_hz,
    )
