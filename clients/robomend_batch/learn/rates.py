"""The rate of a topic: what it is, how far it strays in healthy logs, how long the topic is silent.

A pause that silence lets pass, the rate must let pass, too, and the burst of what was held up after it, even
if the logs show none: in a window that lasts S a pause of P makes S + P of it, and S − P later. The window is
the smallest in which a healthy rate nevertheless stays above SLOWEST of itself, so that half of the
messages missing shows; a topic whose pauses are too long for that is watched for little but silence, and one
that comes irregularly is not watched.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robomend_batch.learn.stretches import Times
from robomend_batch.learn.tails import Bound, bound, largest_of_blocks
from robomend_client.observers.base import SECOND
from robomend_client.observers.general import LEAST_SILENCE_S

LEAST_MESSAGES = 60
WINDOWS = (10, 20, 40, 80, 160, 320, 640)
LONGEST_WINDOW_S = 60.0
LEAST_WINDOWS = 8
"""Windows that the logs must hold side by side."""

SLOWEST = 0.6
"""Of the rate: slower is no healthy one."""

LONGEST_SILENCE_S = 60.0
IRREGULAR = 100.0
"""Usual intervals that a silence bound may last, and LONGEST_SILENCE_S whatever the rate."""

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
    all_gaps = np.concatenate(gaps)
    usual_s = float(np.median(all_gaps))
    if usual_s <= 0:
        return "its messages come several at once"
    silence = bound(all_gaps, hours, per_hour)
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
    return f"{messages} messages: too few for a rate" if found is None else found


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
    spans = [(times[intervals:] - times[:-intervals]) / SECOND for times in pieces if len(times) > intervals]
    if sum(-(-len(one) // window) for one in spans) < LEAST_WINDOWS:
        return None
    usual_s = float(np.median(np.concatenate(spans)))
    rate_hz = intervals / usual_s
    slow = bound(
        np.concatenate([largest_of_blocks(one, window) for one in spans]), hours, per_hour / 2, usual_s
    )
    rates = [intervals / np.maximum(one, usual_s / 100) for one in spans]
    fast = bound(
        np.concatenate([largest_of_blocks(one, window) for one in rates]), hours, per_hour / 2, rate_hz
    )
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
