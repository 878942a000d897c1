"""The general observer (GObs): ok(t) while the messages of topic t come at their rate.

Only the times of messages count, so any topic can be watched without touching the nodes that use it.

    messages   |    |    |    |    |              |    |    |    |    |
    verdict    unknown ·· ok ········ not ok ······· (settling) ···· ok
                                     └ silence_s without one ┘

The rate f of the newest messages is (intervals) / (their span); ok(t) iff |f − rate| < tolerance, or, where
what was held up comes in bursts, rate − tolerance < f < rate + tolerance_above. Silence of
`silence_s` is not ok at once, and what came before it no longer counts. Until the first verdict the topic is
unknown: missing data is no literal. A topic that was never heard of may take `first_s` until it comes up.

After `settle` intervals the rate is ok if it is right, but not sooner after a reset than silence could have
been told. That it is wrong is only said of a window that is
not full yet if it would be wrong even had `lost` messages been lost, or the first one come late by a whole
interval: neither is a fault right after the start.

The defaults stay calm where one message in a thousand is lost, each by itself: `lost` is three, so silence is
3.5 intervals (three messages missing in a row), and the window is so large that three lost messages in it
stay within the tolerance. Where messages are lost in longer runs, `lost` is to be larger.

With `test: student_t`, a wrong rate must be significant, too: |f − rate| ≥ tolerance is the practical
margin, and the mean interval must differ by a t test of level `significance`. That is calmer where
intervals scatter much.

Messages that a busy computer held up come all at once, and a window that begins among them is too short for
its messages, though none came too many. So a rate is only called too fast if it is too fast over longer
windows, too, by as many messages as can have been held up for `held_s`; right after the start, once there are
as many more.

    held up     |   |   |   |          ||||   |   |   |   |   |
                                         └─── too fast ───┘     its own window
                                └──────── not too fast ───┘     with those before it

While this computer is starved, and until the window has nothing of that time in it, a wrong rate is unknown
where it was not wrong before, and silence counts later, by SILENT_S at least: nodes that get no processor
publish late, or not at all.

With `pause_s`, an interval counts in the rate as so long at most. What is longer is a pause, which silence_s
judges: a few of them in a window make its rate no slower than they must, so that half of the messages missing
shows beside them.

What is expected of a topic is a `Rate` (rate.py). Source: the paper, section IV-B.

Student's t test needs no statistics package:

    t = (x̄ − μ₀) √n / s,   n − 1 degrees of freedom;   significant iff |t| > critical(α, n − 1), two-sided

On a good clock s is next to nothing and every bias significant, however small. So whoever uses the test
adds a practical margin: a deviation counts only if it is also large enough to matter. With s = 0 the margin
decides alone.

Source: Student. The probable error of a mean. Biometrika 6(1), 1908. The critical values by Hill's inverse:
G. W. Hill. Algorithm 396: Student's t-quantiles. CACM 13(10), 1970; relative error below 1e-5 for α from
0.001 to 0.5 (tested).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import islice, pairwise
from math import cos, exp, inf, isfinite, pi, sin, sqrt
from statistics import NormalDist
from typing import Any

from robomend_client.literals import Atom, Literal, fails, holds
from robomend_client.observers.base import NOTHING, SECOND, Doubt, Evidence, ns
from robomend_client.observers.rate import Rate
from robomend_client.readings import Reading, Symptom


@lru_cache(maxsize=1024)
def critical(alpha: float, df: int) -> float:
    """Return the t that |t| exceeds with probability `alpha` if the mean is right.

    Args:
        alpha: level of significance, two-sided, above 0 and below 1.
        df: degrees of freedom, 1 or more.
    """
    if not 0 < alpha < 1:
        raise ValueError(f"alpha must be above 0 and below 1, not {alpha:g}")
    if df == 1:
        return cos(alpha * pi / 2) / sin(alpha * pi / 2)
    if df == 2:
        return sqrt(2 / (alpha * (2 - alpha)) - 2)
    a = 1 / (df - 0.5)
    b = 48 / (a * a)
    c = ((20700 * a / b - 98) * a - 16) * a + 96.36
    d = ((94.5 / (b + c) - 3) / b + 1) * sqrt(a * pi / 2) * df
    y = (d * alpha) ** (2 / df)
    if y > 0.05 + a:
        x = NormalDist().inv_cdf(alpha / 2)
        y = x * x
        if df < 5:
            c += 0.3 * (df - 4.5) * (x + 0.6)
        c = (((0.05 * d * x - 5) * x - 7) * x - 2) * x + b + c
        y = (((((0.4 * y + 6.3) * y + 36) * y + 94.5) / c - y - 3) / b + 1) * x
        y = a * y * y
        y = exp(y) - 1 if y > 0.002 else 0.5 * y * y + y
    else:
        y = ((1 / (((df + 6) / (df * y) - 0.089 * d - 0.822) * (df + 2) * 3) + 0.5 / (df + 4)) * y - 1) * (
            df + 1
        ) / (df + 2) + 1 / y
    return sqrt(df * y)


def significant(deviation: float, variance: float, n: int, alpha: float) -> bool:
    """Return whether a mean of `n` samples deviates significantly.

    Args:
        deviation: x̄ − μ₀.
        variance: of the samples, s², with n − 1 in the denominator.
        n: how many samples; of fewer than two nothing is known.
        alpha: level of significance, two-sided.
    """
    if n < 2:
        return False
    if variance <= 0:
        return deviation != 0
    return deviation * deviation * n > variance * critical(alpha, n - 1) ** 2


SILENT_S = 4.0
"""Silence lasts so much longer on a computer that is starved, or twice as long."""


class GeneralObserver:
    """Watches the rate of one topic."""

    def __init__(self, topic: str, expected: Rate | None = None) -> None:
        """
        Args:
            topic: the topic, as the model has it; by default the entry's name.
            expected: of its rate.
        """
        self.topic = topic
        self.expected = expected = expected or Rate()
        self.sources = frozenset((topic,))
        self.atoms = (Atom("ok", (topic,)),)
        self.period_ns = ns(expected.check_s)
        self.detection_s = expected.silence + expected.check_s
        self.settling_s = expected.first_verdict_s + expected.check_s
        self._ok = (holds("ok", topic),)
        self._not_ok = (fails("ok", topic),)
        self._silence_ns = ns(expected.silence)
        self._size = expected.messages
        self._full = float((self._size - 1) * SECOND)  # a whole window's intervals, by its span: its rate
        self._intervals = expected.intervals
        self._lowest_hz, self._highest_hz = expected.lowest_hz, expected.highest_hz
        self._held = expected.held
        # Two windows of them: when the rate turns wrong, the message at which it was right is in there.
        most = 2 * self._size + self._held
        self._times: deque[int] = deque(maxlen=most)
        # The same without what is longer of their intervals than a pause: it is what rates are of.
        self._pause_ns = None if expected.pause_s is None else ns(expected.pause_s)
        self._counted: deque[int] = self._times if self._pause_ns is None else deque(maxlen=most)
        self._doubt = Doubt(self._size / expected.lowest_hz if expected.lowest_hz > 0 else 0.0)
        self._longer_ns = max(self._silence_ns, ns(SILENT_S))
        self._known_bad = False  # before the doubt, and since then
        self._first_ns = max(0, ns(expected.first_s or 0.0) - self._silence_ns)
        self._back_ns = max(self._silence_ns, ns(self._size / expected.rate_hz))
        self._start_ns: int | None = None  # the first reset; None: there was none
        self._heard_ns: int | None = None  # the newest message of all, also of those before a reset
        self._publishers: tuple[str, ...] | None = None  # None: nobody says who they are
        self._good_from_ns = 0
        self._usual_ns = 0  # gaps below it are regular; 0 until the very first message
        self._forget(0)

    def reset(self, time_ns: int) -> None:
        """Silence counts from here on; of a topic that was never heard of, from its `first_s` on."""
        if self._start_ns is None or time_ns < self._start_ns:
            self._start_ns = time_ns
        self._good_from_ns = time_ns + self._silence_ns
        self._forget(time_ns)

    def _forget(self, time_ns: int) -> None:
        self._clear()
        self._newest_ns = time_ns
        if not self._usual_ns:
            self._newest_ns = max(time_ns, (self._start_ns or 0) + self._first_ns)
        self._silence_end_ns: int | None = None  # of the newest silence; None: there was none
        self._silence_began_ns = 0  # of that: the last message before it
        self._known_bad = False
        self._onset_ns: int | None = None  # the newest message at which the rate was right

    def _clear(self) -> None:
        self._times.clear()
        self._counted.clear()
        self._good_ns: int | None = None  # the newest message at which the rate was right,
        self._looked_ns: int | None = None  # of those up to this

    def feed(self, source: str, time_ns: int, value: object = None) -> None:
        """A message of the topic arrived at `time_ns`; its value does not matter."""
        gap_ns = time_ns - self._newest_ns
        if not 0 <= gap_ns < self._usual_ns:
            time_ns = self._irregular(time_ns, gap_ns, self.due_ns())
        if self._pause_ns is not None:
            counted = self._counted
            counted.append(counted[-1] + min(time_ns - self._newest_ns, self._pause_ns) if counted else 0)
        self._times.append(time_ns)
        self._newest_ns = self._heard_ns = time_ns

    def _irregular(self, time_ns: int, gap_ns: int, due_ns: int) -> int:
        """The first message, one after a silence, or one from before the newest: return the time that
        counts.
        """
        first = not self._usual_ns
        self._usual_ns = self._silence_ns
        if time_ns >= due_ns:
            self._onset_ns = self._last_good_ns()
            self._silence_end_ns, self._silence_began_ns = time_ns, self._last_heard_ns()
            self._clear()
        elif gap_ns < -self._back_ns and not first:
            self.reset(time_ns)
        elif gap_ns < 0 and not first:
            time_ns = self._newest_ns
        return time_ns

    def starved(self, yes: bool, time_ns: int) -> None:
        """This computer is from now on, or no more: who publishes here is late as well."""
        if yes and not self._doubt.at(time_ns):
            self._known_bad = self._right() is False or time_ns >= self.due_ns()
        self._doubt.starved(yes, time_ns)

    def due_ns(self) -> int:
        due_ns = self._newest_ns + self._silence_ns
        if self._known_bad:
            return due_ns
        # From the last message on, also where time in which nobody looked has silence begin anew: who is
        # starved for long looks away again and again, and would not come to the end of the longer one.
        heard_ns = self._newest_ns if self._heard_ns is None else self._heard_ns
        return max(due_ns, self._doubt.put_off(heard_ns + self._silence_ns, self._longer_ns))

    def check(self, now_ns: int) -> tuple[Literal, ...]:
        if now_ns - self._newest_ns >= self._silence_ns and now_ns >= self.due_ns():
            return self._not_ok
        counted, size = self._counted, self._size
        if len(counted) >= size:  # most of the time, and asked for most often
            span_ns = counted[-1] - counted[-size]
            if span_ns and self._lowest_hz < self._full / span_ns < self._highest_hz:
                self._known_bad = False
                return self._ok if now_ns >= self._good_from_ns else NOTHING
        right = self._right()
        if right is None:
            return NOTHING if self._silence_end_ns is None else self._not_ok
        if right:
            self._known_bad = False
            return self._ok if now_ns >= self._good_from_ns else NOTHING
        return NOTHING if self._doubt.at(now_ns) and not self._known_bad else self._not_ok

    def steady(self, times_ns: Any, values: Any, until_ns: int) -> Callable[[], None] | None:
        """See Steady: all is well before, at and behind each of these messages."""
        import numpy as np

        size = self._size
        if len(self._times) < size or until_ns - int(times_ns[-1]) >= self._silence_ns:
            return None
        known = np.fromiter(islice(reversed(self._times), size), np.int64, size)[::-1]
        times_ns = np.concatenate([known, times_ns])
        gaps_ns = times_ns[size:] - times_ns[size - 1 : -1]
        if gaps_ns[0] < 0 or gaps_ns.max() >= min(self._usual_ns, self._silence_ns):
            return None
        counted_ns = times_ns
        if self._pause_ns is not None:
            before = np.fromiter(islice(reversed(self._counted), size), np.int64, size)[::-1]
            counted_ns = np.concatenate([before, before[-1] + np.cumsum(np.minimum(gaps_ns, self._pause_ns))])
        spans_ns = counted_ns[size - 1 :] - counted_ns[: 1 - size]
        shortest_ns, longest_ns = int(spans_ns.min()), int(spans_ns.max())
        if shortest_ns <= 0:
            return None
        if self._full / longest_ns <= self._lowest_hz or self._full / shortest_ns >= self._highest_hz:
            return None

        def take() -> None:
            self._times.extend(times_ns[size:].tolist())
            if self._pause_ns is not None:
                self._counted.extend(counted_ns[size:].tolist())
            self._newest_ns = self._heard_ns = self._times[-1]

        return take

    def evidence(self, atom: Atom, now_ns: int) -> Evidence:
        if now_ns - self._newest_ns >= self._silence_ns and now_ns >= self.due_ns():
            nobody = "" if self._publishers is None or self._publishers else "nobody publishes it"
            silent = self._silent(now_ns, self._last_heard_ns(), nobody)
            return Evidence(now_ns - self._silence_ns, self._last_good_ns(), silent)
        right = self._right()
        if right is None and self._silence_end_ns is not None:
            silent = self._silent(self._silence_end_ns, self._silence_began_ns, "then heard again")
            return Evidence(self._silence_end_ns - self._silence_ns, self._onset_ns, silent)
        intervals = min(len(self._times), self._size) - 1
        counted = tuple(self._counted)
        reach = self._reach(counted, len(counted) - 1, intervals) if right else 0
        since_ns = self._times[-1 - (reach or intervals)]
        return Evidence(since_ns, None if right else self._last_good_ns(), self._measured(bool(right)))

    def published_by(self, nodes: Sequence[str], time_ns: int) -> None:
        """These nodes publish the topic, as far as the graph shows: said in the reading of a bad verdict."""
        self._publishers = tuple(nodes)

    def _last_heard_ns(self) -> int:
        return self._heard_ns if self._heard_ns is not None else self._start_ns or 0

    def _silent(self, until_ns: int, began_ns: int, more: str) -> Reading:
        told = f"0 of {self.expected.rate_hz:g} Hz for {max(0, until_ns - began_ns) / SECOND:.3g} s"
        return Reading(told, "", more, Symptom.SILENT)

    def _measured(self, right: bool) -> Reading:
        """Return the rate, and on which side of its band it is."""
        f = self.rate_hz() or 0.0
        limit = str(self.expected)
        if right:
            return Reading(_told(f), "Hz", limit)
        symptom = Symptom.FAST if f >= self.expected.rate_hz else Symptom.SLOW
        if self._publishers is not None and len(self._publishers) > 1:
            limit += f"; publishers: {', '.join(self._publishers)}"
            if symptom is Symptom.FAST:
                symptom = Symptom.PUBLISHERS
        return Reading(_told(f), "Hz", limit, symptom)

    @property
    def patience_s(self) -> float:
        """What waited comes all at once: the rate bears that while it stays within the tolerance.

        Half of it is left to what the topic's own messages are late by.
        """
        intervals = min(len(self._times), self._size) - 1
        if intervals < self._intervals:
            return 0.0
        rate_hz, highest_hz = self.expected.rate_hz, self.expected.highest_hz
        return 0.5 * intervals * (highest_hz - rate_hz) / (rate_hz * highest_hz)

    def rate_hz(self) -> float | None:
        """Return the measured rate, or None while there is none to speak of."""
        intervals = min(len(self._times), self._size) - 1
        if intervals < self._intervals:
            return None
        span_ns = self._counted[-1] - self._counted[-1 - intervals]
        return intervals * SECOND / span_ns if span_ns else inf

    # --- inside ----------------------------------------------------------------------------------------

    def _right(self) -> bool | None:
        """Return whether the rate is right; None while that cannot be said."""
        counted, size = self._counted, self._size
        have = len(counted)
        intervals = (have if have < size else size) - 1
        if intervals < self._intervals:
            return None
        span_ns = counted[-1] - counted[-1 - intervals]
        expected = self.expected
        f = intervals * SECOND / span_ns if span_ns else inf
        if self._lowest_hz < f < self._highest_hz:
            return True
        chance = False
        if f >= self._highest_hz and self._held:
            if self._reach(tuple(counted), have - 1, intervals):
                return True
            rest = have - 1 - self._held  # so far: were the first ones held up?
            if rest < intervals:
                span_rest_ns = counted[-1] - counted[-1 - rest] if rest >= self._intervals else 0
                chance = not span_rest_ns or rest * SECOND / span_rest_ns < self._highest_hz
        if have < size and span_ns and not chance:
            if f < expected.rate_hz:  # so far: were messages lost?
                chance = (intervals + expected.lost) * SECOND / span_ns >= self._lowest_hz
            else:  # was the first one late?
                chance = (intervals - 1) * SECOND / span_ns <= self._highest_hz
        if chance:
            return True if self._good_before() is not None else None
        return expected.test == "student_t" and not self._significant(intervals)

    def _reach(self, counted: tuple[int, ...], last: int, intervals: int) -> int:
        """Return how many intervals make the rate at a message right: those of the window, or, where it is
        too fast, as many more as may have been held up; 0: it is wrong over all of them.
        """
        end_ns = counted[last]
        span_ns = end_ns - counted[last - intervals]
        if span_ns and intervals * SECOND / span_ns <= self._lowest_hz:
            return 0
        for n in range(intervals, min(intervals + self._held, last) + 1):
            span_ns = end_ns - counted[last - n]
            if span_ns and n * SECOND / span_ns < self._highest_hz:
                return n
        return 0

    def _last_good_ns(self) -> int | None:
        """Return the newest message that was good news: not one of a rate that was wrong by then."""
        right = self._right()
        if right is not False and self._silence_end_ns is None and self._times:
            return self._newest_ns  # it came in time, and nothing was wrong
        if right:
            return self._newest_ns
        good_ns = self._good_before()
        if good_ns is not None:
            self._onset_ns = good_ns
        return self._onset_ns

    def _good_before(self) -> int | None:
        """Return the newest message at which the rate was right, since the newest silence.

        None of them is looked at twice: what it was then, it is still, and of a window whose beginning is
        forgotten less is known than was then.
        """
        times, counted = tuple(self._times), tuple(self._counted)
        for last in range(len(times) - 1, self._intervals - 1, -1):
            if self._looked_ns is not None and times[last] < self._looked_ns:
                break
            if self._reach(counted, last, min(last, self._size - 1)):
                self._good_ns = times[last]
                break
        self._looked_ns = self._newest_ns
        return self._good_ns

    def _significant(self, n: int) -> bool:
        """Return whether the mean of the newest n intervals differs significantly from what it should be."""
        times = tuple(self._counted)[-n - 1 :]
        span_ns = times[-1] - times[0]
        # Exact in integers up to the last division: squares of nanoseconds are beyond what a float holds.
        squares = sum((b - a) ** 2 for a, b in pairwise(times))
        variance = (n * squares - span_ns * span_ns) / (n * (n - 1)) if n > 1 else 0.0
        deviation_ns = span_ns / n - SECOND / self.expected.rate_hz
        return significant(deviation_ns, variance, n, self.expected.significance)


def _told(f: float) -> float | str:
    """Return a rate as people are told it: three digits will do."""
    return float(f"{f:.3g}") if isfinite(f) else "all at once,"
