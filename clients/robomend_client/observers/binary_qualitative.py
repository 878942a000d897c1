"""The binary qualitative observer (BiQObs): matched(v1, v2) while the trends of two values are alike.

    value 1   ····mean····mean····mean   → trend ┐ value 2   ····mean····mean····mean   → trend ┴ equal:
    mismatch − 1, else + 1 (from 0 to twice the threshold)
              └ tick_s ┘                           matched iff mismatch ≤ threshold

Each tick takes the mean of the samples since the last one. By `compare`, a value counts by its trend (the
slope of the means) or by its sign (the mean itself, against the same b): a commanded speed says the sign of
what odometry says as a trend. `derive: first` takes finite differences of the first value instead of the
value.

When one of them says nothing for a window, the match is unknown, and the count begins anew. A match is only
said after as many ticks as a mismatch takes to be said, and where the count was low then: until then nothing
could have shown it.

Source: the paper, section IV-B. `preset: published` has its parameters; its counter had no upper bound, so
that a long mismatch took as long to be forgotten, and a silent topic counted as a mismatch.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from robomend_client.literals import Atom, Literal, parse_atom
from robomend_client.observers.base import NOTHING, Evidence, ns, number, positive
from robomend_client.observers.qualitative import CONST, DEC, INC, PATIENCE, WORDS, Trend, TrendOf
from robomend_client.readings import Reading, Symptom

COMPARED = ("trend-trend", "trend-sign", "sign-trend", "sign-sign")


@dataclass(frozen=True)
class Match:
    """When two values count as alike. The second value's parameters are the first one's, unless they are
    given.

    Attributes:
        window_s: a trend is fitted over so many seconds.
        slope: b, in units of the first value per second; of a sign, in its units.
        second_window_s: the window of the second value, in seconds; by default window_s.
        second_slope: b of the second value, in its units per second; by default slope.
        compare: by what the first and the second value count: `trend-trend`, `trend-sign`, `sign-trend` or
            `sign-sign`.
        derive: `first`: finite differences of the first value count, in place of the value.
        threshold: ticks of mismatch that are still a match.
        tick_s: the means of so many seconds are compared.
    """

    window_s: float = 1.0
    slope: float = 0.05
    second_window_s: float | None = None
    second_slope: float | None = None
    compare: str = "trend-trend"
    derive: str = "none"
    threshold: int = 20
    tick_s: float = 0.2

    PRESETS: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "published": {"window_s": 1.0, "slope": 5e-7, "threshold": 20, "tick_s": 0.2}
    }

    def __post_init__(self) -> None:
        positive(window_s=self.window_s, slope=self.slope, tick_s=self.tick_s)
        for name in ("second_window_s", "second_slope"):
            if getattr(self, name) is not None:
                positive(**{name: getattr(self, name)})
        if self.compare not in COMPARED:
            raise ValueError(f"compare must be one of {', '.join(COMPARED)}, not {self.compare!r}")
        if self.derive not in ("none", "first"):
            raise ValueError(f"derive must be one of none, first, not {self.derive!r}")
        if not 0 <= self.threshold <= 100_000:
            raise ValueError(f"threshold must be from 0 to 100000, not {self.threshold}")
        for name in ("window_s", "second_window_s"):
            window_s = getattr(self, name)
            if window_s is not None and window_s < 3 * self.tick_s:
                raise ValueError(
                    f"{name} must be at least three ticks of {self.tick_s:g} s: a line needs three"
                )


class BinaryQualitativeObserver:
    """Watches whether two values behave alike."""

    def __init__(self, atom: str, first: str, second: str, expected: Match | None = None) -> None:
        """
        Args:
            atom: what it speaks of, e.g. `matched(odom_yaw,imu_yaw)`; by default the entry's name.
            first: topic and field of the first value, e.g. `odom:twist.twist.angular.z`.
            second: topic and field of the second value.
            expected: when they are alike.
        """
        if first == second:
            raise ValueError(f"second must be another value than first, {first}")
        expected = expected or Match()
        self.atoms: tuple[Atom, ...] = (parse_atom(atom),)
        self.sources = frozenset((first, second))
        self.period_ns = 0
        ways = expected.compare.split("-")
        second_window_s = expected.second_window_s or expected.window_s
        self._tick_ns = ns(expected.tick_s)
        self._threshold = expected.threshold
        self._sides = {
            first: _Side(expected.window_s, expected.slope, ways[0], expected.derive == "first"),
            second: _Side(second_window_s, expected.second_slope or expected.slope, ways[1], False),
        }
        window_s = max(expected.window_s, second_window_s)
        self._window_ns = ns(window_s)
        self.patience_s = PATIENCE * window_s
        self._delay_s = window_s + (expected.threshold + 3) * expected.tick_s
        self._signs = {good: (Literal(self.atoms[0], good),) for good in (True, False)}
        self.reset(0)

    def reset(self, time_ns: int) -> None:
        for side in self._sides.values():
            side.reset()
        self._from_ns = time_ns
        self._next_ns: int | None = None  # the next tick; None while nothing comes
        self._forget()

    def feed(self, source: str, time_ns: int, value: object) -> None:
        reading = number(value)
        if self._next_ns is None:
            self._next_ns = (time_ns // self._tick_ns + 1) * self._tick_ns
        self._run(time_ns)
        self._sides[source].add(reading)

    @property
    def detection_s(self) -> float:
        return self._delay_s + max(side.stretched_s for side in self._sides.values())

    @property
    def settling_s(self) -> float:
        return self.detection_s

    def due_ns(self) -> int | None:
        return self._next_ns

    def check(self, now_ns: int) -> tuple[Literal, ...]:
        self._run(now_ns)
        return NOTHING if self._verdict is None else self._signs[self._verdict]

    def evidence(self, atom: Atom, now_ns: int) -> Evidence:
        span_ns = self._window_ns + (self._threshold + 1) * self._tick_ns
        since_ns = max(self._from_ns, self._ticked_ns - span_ns)
        good = self._mismatch is not None and self._mismatch <= self._threshold
        return Evidence(since_ns, None if good else self._equal_ns, self._reading(good))

    def _reading(self, good: bool) -> Reading:
        """Return how the two values behave."""
        if not good:
            for source, side in self._sides.items():
                (other,) = (s for s in self._sides if s != source)
                if side.still and not self._sides[other].still:
                    still = f"{source} stands still at {side.mean:g}, {other} does not"
                    return Reading(still, symptom=Symptom.STILL)
        told = " and ".join(f"{WORDS[side.says]} ({side.mean:g})" for side in self._sides.values())
        limit = f"at most {self._threshold} ticks of mismatch"
        return Reading(told, "", limit, None if good else Symptom.VALUE)

    @property
    def mismatch(self) -> int | None:
        """The count; None while nothing is known."""
        return self._mismatch

    # --- inside ----------------------------------------------------------------------------------------

    def _forget(self) -> None:
        self._mismatch: int | None = None
        self._ticks = 0  # that were counted, up to twice as many as a mismatch takes
        self._verdict: bool | None = None
        self._ticked_ns = self._from_ns
        self._equal_ns: int | None = None  # the newest tick without any mismatch

    def _run(self, until_ns: int) -> None:
        """Make up for the ticks up to a time; they fall on one grid, however often anybody asks."""
        while self._next_ns is not None and self._next_ns <= until_ns:
            tick_ns = self._next_ns
            self._next_ns += self._tick_ns
            trends = [side.tick(tick_ns) for side in self._sides.values()]
            if None not in trends:
                self._count(tick_ns, trends[0] == trends[1])
            elif self._mismatch is not None:
                self._forget()
            if all(side.silent for side in self._sides.values()):
                self._next_ns = None

    def _count(self, tick_ns: int, equal: bool) -> None:
        mismatch = self._mismatch or 0
        self._mismatch = max(0, mismatch - 1) if equal else min(2 * self._threshold + 1, mismatch + 1)
        self._ticks = min(2 * self._threshold + 2, self._ticks + 1)
        if self._mismatch > self._threshold:
            self._verdict = False
        elif self._ticks > self._threshold:
            # What were alike for the first ticks, and are not since, have not been shown to match.
            clear = self._mismatch <= self._threshold // 2 or self._ticks > 2 * self._threshold + 1
            self._verdict = True if clear or self._verdict is not None else None
        self._ticked_ns = tick_ns
        if self._mismatch == 0:
            self._equal_ns = tick_ns


class _Side:
    """One of the two values, tick by tick."""

    def __init__(self, window_s: float, slope: float, way: str, derive: bool) -> None:
        self._trend = TrendOf(Trend(window_s=window_s, slope=slope, hysteresis=0.0))
        self._by_sign = way == "sign"
        self._slope = slope
        self._window_ns = ns(window_s)
        self._derive = derive
        self.reset()

    def reset(self) -> None:
        self._trend.reset()
        self._sum, self._n = 0.0, 0
        self._mean: float | None = None
        self._mean_ns = self._changed_ns = 0
        self._sign: int | None = None
        self.silent = True

    def add(self, value: float) -> None:
        self._sum += value
        self._n += 1
        self.silent = False

    @property
    def stretched_s(self) -> float:
        """By how much the trend's window is longer, for the value's steps."""
        return 0.0 if self._by_sign else self._trend.stretched_s

    @property
    def mean(self) -> float:
        """The newest mean."""
        return self._mean or 0.0

    @property
    def says(self) -> int:
        """The trend, or the sign, as `tick` has returned it last."""
        says = self._sign if self._by_sign else self._trend.now
        return CONST if says is None else says

    @property
    def still(self) -> bool:
        """Whether the value has not changed at all for a window."""
        return self._mean_ns - self._changed_ns >= self._window_ns

    def tick(self, tick_ns: int) -> int | None:
        """Return the trend, or the sign; None where nothing is known."""
        if self._n:
            mean, before, before_ns = self._sum / self._n, self._mean, self._mean_ns
            self._sum, self._n = 0.0, 0
            self._mean, self._mean_ns = mean, tick_ns
            if mean != before:
                self._changed_ns = tick_ns
            if self._derive:
                if before is None:
                    return None
                mean = (mean - before) / (tick_ns - before_ns) * 1e9
            self._trend.feed("", tick_ns, mean)
            self._sign = INC if mean > self._slope else DEC if mean < -self._slope else CONST
        elif tick_ns - self._mean_ns >= self._window_ns:
            self.reset()
            return None
        return self._sign if self._by_sign else self._trend.now
