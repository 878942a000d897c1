"""The general observer (GObs): ok(t) while the messages of topic t come at their rate.

Only the times of messages count, so any topic can be watched without touching the nodes that use it.

    messages   |    |    |    |    |              |    |    |    |    |
    verdict    unknown ·· ok ········ not ok ······· (settling) ···· ok
                                     └ silence_s without one ┘

The rate f of the newest messages is (intervals) / (their span); ok(t) iff |f − rate| < tolerance, or, where
what was held up comes in bursts, rate − tolerance < f < rate + tolerance_above. Silence of
`silence_s` is not ok at once, and what came before it no longer counts. Until the first verdict the topic is
unknown: missing data is no literal. A topic that was never heard of may take `first_s` until it comes up.

After `settle` intervals the rate is ok if it is right. That it is wrong is only said of a window that is
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
windows, too, by as many messages as can have been held up for `held_s`.

    held up     |   |   |   |          ||||   |   |   |   |   |
                                         └─── too fast ───┘     its own window
                                └──────── not too fast ───┘     with those before it

With `pause_s`, an interval counts in the rate as so long at most. What is longer is a pause, which silence_s
judges: a few of them in a window make its rate no slower than they must, so that half of the messages missing
shows beside them.

Source: the paper, section IV-B; rate, tolerance, window and silence as published by `preset: published` (the
paper's ω is a time window, the published observer's a number of messages).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import islice, pairwise
from math import ceil, inf
from typing import Any, ClassVar

from robomend_client.literals import Atom, Literal, fails, holds
from robomend_client.observers.base import NOTHING, SECOND, Evidence, ns, positive
from robomend_client.observers.student_t import significant

LEAST_SILENCE_S = 0.35
"""Whatever the rate, for a busy computer is late by a tenth of a second or two."""

TESTS = ("tolerance", "student_t")


@dataclass(frozen=True)
class Rate:
    """What is expected of a topic. A parameter that is None follows from the others.

    Attributes:
        rate_hz: the rate that is expected, in messages per second.
        tolerance_hz: ok while the rate of the window differs by less, in messages per second.
        window: the rate is that of so many messages; by default so many, 10 at least, that `lost` lost ones
            stay within the tolerance.
        silence_s: so many seconds without a message are not ok; by default half an interval more than `lost`
            intervals, 0.35 s at least.
        first_s: until its very first message, silence counts after so many seconds; by default silence_s, and
            under `topics:` 2.
        check_s: how often a verdict on the rate is given, in seconds.
        settle: intervals between messages that a verdict needs.
        test: `tolerance`, or `student_t`: a wrong rate must be significant as well.
        significance: the level of the t test, two-sided: a probability.
        tolerance_above_hz: how much faster it may be, in messages per second; by default tolerance_hz.
        pause_s: an interval counts in the rate as so many seconds at most; by default as it is.
        lost: messages that may be lost in a window; missing in a row they are silence.
        held_s: messages may be held up for so many seconds, and then come at once; by default as long as
            silence.
    """

    rate_hz: float = 10.0
    tolerance_hz: float = 1.0
    window: int | None = None
    silence_s: float | None = None
    first_s: float | None = None
    check_s: float = 0.05
    settle: int | None = 5  # None: a full window
    test: str = "tolerance"
    significance: float = 0.05
    tolerance_above_hz: float | None = None
    pause_s: float | None = None
    lost: int = 3
    held_s: float | None = None

    PRESETS: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "published": {"window": 10, "silence_s": 2.0, "check_s": 0.5, "settle": None, "held_s": 0.0}
    }

    def __post_init__(self) -> None:
        positive(rate_hz=self.rate_hz, tolerance_hz=self.tolerance_hz, check_s=self.check_s)
        if self.tolerance_above_hz is not None:
            positive(tolerance_above_hz=self.tolerance_above_hz)
        if self.window is not None and not 2 <= self.window <= 10_000:
            raise ValueError(
                f"window must be from 2 to 10000 messages, not {self.window}: a rate needs an interval"
            )
        if not 1 <= self.lost <= 1000:
            raise ValueError(f"lost must be from 1 to 1000 messages, not {self.lost}")
        if self.settle is not None and (self.settle < 1 or (self.window and self.settle >= self.window)):
            most = f"window − 1 = {self.window - 1}" if self.window else "window − 1"
            raise ValueError(f"settle must be from 1 to {most}, not {self.settle}")
        if self.silence_s is not None:
            positive(silence_s=self.silence_s)
            if self.silence_s * self.rate_hz <= 1:
                raise ValueError(
                    f"silence_s of {self.silence_s:g} is no longer than one interval at {self.rate_hz:g} Hz: "
                    "every message would come too late"
                )
        if self.pause_s is not None and not self.pause_s * self.rate_hz > 1:
            raise ValueError(
                f"pause_s of {self.pause_s:g} is no longer than one interval at {self.rate_hz:g} Hz: "
                "no rate could be too slow"
            )
        if self.first_s is not None and not 0 <= self.first_s <= 86400:
            raise ValueError(f"first_s must be from 0 to 86400, not {self.first_s:g}")
        if self.held_s is not None and not 0 <= self.held_s <= 86400:
            raise ValueError(f"held_s must be from 0 to 86400, not {self.held_s:g}")
        if self.test not in TESTS:
            raise ValueError(f"test must be one of {', '.join(TESTS)}, not {self.test!r}")
        if not 0 < self.significance < 1:
            raise ValueError(f"significance must be above 0 and below 1, not {self.significance:g}")

    @classmethod
    def published(cls, rate_hz: float = 10.0, tolerance_hz: float = 1.0) -> Rate:
        """Return the released system's parameters."""
        return cls(rate_hz, tolerance_hz, **cls.PRESETS["published"])

    @property
    def lowest_hz(self) -> float:
        """A rate must be above it."""
        return self.rate_hz - self.tolerance_hz

    @property
    def highest_hz(self) -> float:
        """And below this."""
        above_hz = self.tolerance_above_hz
        return self.rate_hz + (self.tolerance_hz if above_hz is None else above_hz)

    @property
    def messages(self) -> int:
        """The size of the window: of n intervals k lost ones take k of n + k, and some of it is for
        jitter.
        """
        if self.window is not None:
            return self.window
        enough = ceil(self.lost * self.rate_hz / (0.85 * self.tolerance_hz)) - self.lost + 1
        return max(10, (self.settle or 0) + 1, min(enough, 10_000))

    @property
    def intervals(self) -> int:
        """How many a verdict needs."""
        return self.messages - 1 if self.settle is None else self.settle

    @property
    def silence(self) -> float:
        """Seconds without a message that are not ok."""
        if self.silence_s is not None:
            return self.silence_s
        return max(LEAST_SILENCE_S, (self.lost + 0.5) / self.rate_hz)

    @property
    def held(self) -> int:
        """How many messages can have been held up, and come at once."""
        held_s = self.silence if self.held_s is None else self.held_s
        return min(ceil(held_s * self.rate_hz), 1000)


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
        slowest_hz = max(expected.lowest_hz, expected.rate_hz / 2)
        self.settling_s = max(expected.silence, (expected.intervals + 1) / slowest_hz) + expected.check_s
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
        self._first_ns = max(0, ns(expected.first_s or 0.0) - self._silence_ns)
        self._back_ns = max(self._silence_ns, ns(self._size / expected.rate_hz))
        self._start_ns: int | None = None  # the first reset; None: there was none
        self._usual_ns = 0  # gaps below it are regular; 0 until the very first message
        self._forget(0)

    def reset(self, time_ns: int) -> None:
        """Silence counts from here on; of a topic that was never heard of, from its `first_s` on."""
        if self._start_ns is None or time_ns < self._start_ns:
            self._start_ns = time_ns
        self._forget(time_ns)

    def _forget(self, time_ns: int) -> None:
        self._clear()
        self._newest_ns = time_ns
        if not self._usual_ns:
            self._newest_ns = max(time_ns, (self._start_ns or 0) + self._first_ns)
        self._silence_end_ns: int | None = None  # of the newest silence; None: there was none
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
            time_ns = self._irregular(time_ns, gap_ns)
        if self._pause_ns is not None:
            counted = self._counted
            counted.append(counted[-1] + min(time_ns - self._newest_ns, self._pause_ns) if counted else 0)
        self._times.append(time_ns)
        self._newest_ns = time_ns

    def _irregular(self, time_ns: int, gap_ns: int) -> int:
        """The first message, one after a silence, or one from before the newest: return the time that
        counts.
        """
        first = not self._usual_ns
        self._usual_ns = self._silence_ns
        if gap_ns >= self._silence_ns:
            self._onset_ns = self._last_good_ns()
            self._silence_end_ns = time_ns
            self._clear()
        elif gap_ns < -self._back_ns and not first:
            self.reset(time_ns)
        elif gap_ns < 0 and not first:
            time_ns = self._newest_ns
        return time_ns

    def due_ns(self) -> int:
        return self._newest_ns + self._silence_ns

    def check(self, now_ns: int) -> tuple[Literal, ...]:
        if now_ns - self._newest_ns >= self._silence_ns:
            return self._not_ok
        counted, size = self._counted, self._size
        if len(counted) >= size:  # most of the time, and asked for most often
            span_ns = counted[-1] - counted[-size]
            if span_ns and self._lowest_hz < self._full / span_ns < self._highest_hz:
                return self._ok
        right = self._right()
        if right is None:
            return NOTHING if self._silence_end_ns is None else self._not_ok
        return self._ok if right else self._not_ok

    def steady(self, times_ns: Any, values: Any, until_ns: int) -> Callable[[], None] | None:
        """See Steady: all is well before, at and behind each of these messages."""
        import numpy as np

        size = self._size
        if len(self._times) < size or until_ns - int(times_ns[-1]) >= self._silence_ns:
            return None
        known = np.fromiter(islice(reversed(self._times), size), np.int64, size)[::-1]
        times_ns = np.concatenate([known, times_ns])
        gaps_ns = np.diff(times_ns[size - 1 :])
        if gaps_ns.min() < 0 or gaps_ns.max() >= min(self._usual_ns, self._silence_ns):
            return None
        counted_ns = times_ns
        if self._pause_ns is not None:
            before = np.fromiter(islice(reversed(self._counted), size), np.int64, size)[::-1]
            counted_ns = np.concatenate([before, before[-1] + np.cumsum(np.minimum(gaps_ns, self._pause_ns))])
        spans_ns = counted_ns[size - 1 :] - counted_ns[: 1 - size]
        if spans_ns.min() <= 0:
            return None
        rates_hz = (size - 1) * SECOND / spans_ns
        if rates_hz.min() <= self._lowest_hz or rates_hz.max() >= self._highest_hz:
            return None

        def take() -> None:
            self._times.extend(times_ns[size:].tolist())
            if self._pause_ns is not None:
                self._counted.extend(counted_ns[size:].tolist())
            self._newest_ns = self._times[-1]

        return take

    def evidence(self, atom: Atom, now_ns: int) -> Evidence:
        if now_ns - self._newest_ns >= self._silence_ns:
            return Evidence(now_ns - self._silence_ns, self._last_good_ns())
        right = self._right()
        if right is None and self._silence_end_ns is not None:
            return Evidence(self._silence_end_ns - self._silence_ns, self._onset_ns)
        intervals = min(len(self._times), self._size) - 1
        counted = tuple(self._counted)
        reach = self._reach(counted, len(counted) - 1, intervals) if right else 0
        return Evidence(self._times[-1 - (reach or intervals)], None if right else self._last_good_ns())

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
        if f >= self._highest_hz and self._held and self._reach(tuple(counted), have - 1, intervals):
            return True
        if have < size and span_ns:
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
