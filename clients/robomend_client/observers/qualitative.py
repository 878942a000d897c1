"""The qualitative observer (QObs): inc(v), dec(v) or const(v), the trend of a value in the messages of a
topic.

    slope r of the regression line over window_s:   r > b  inc      r < −b  dec      else const

The three exclude each other, so each verdict comes with the negation of the other two. With `hysteresis` a
trend that was told holds on until |r| is below b (1 − hysteresis); with `debounce_s` a new one must last
that long. A value of an angle that wraps around has `wraps_at` (360, or 6.28318530718).

A value that moves in steps (whole seconds, ticks of an encoder) stands between them. So the window is three
of its steps at least: of whole-second stamps over one second the line would rise and stand in turn. When it
stands for more than two steps, or three windows, it stands. Of whole numbers that stood for a moment nothing
is said after a reset until one step was seen as a whole, or they stand.

A line needs three samples over half the window; without, and when no sample came for a whole window,
nothing is said. What is not a number (NaN, infinite) is left out.

Source: the paper, section IV-B. The published observer meant a hysteresis by derivatives, which never ran:
whenever it was asked it said const.

The slope is that of least squares over the window, in O(1) a sample:

    slope = (n Σtv − Σt Σv) / (n Σt² − (Σt)²)

Times and values are taken relative to an origin that moves with the window, and the sums are added up anew
every REBUILD windows, and when a value that dwarfs the others has left: so that rounding neither grows with
the age of the robot nor with the size of the value. Times are nanoseconds, as whole numbers that a float
holds exactly.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from robomend_client.literals import Atom, Literal
from robomend_client.observers.base import NOTHING, SECOND, Evidence, ns, number, positive
from robomend_client.readings import Reading, Symptom

REBUILD = 32
"""Windows after which the sums are added up anew; it costs what a sample costs for each one of the window."""
LOWEST, HIGHEST = -1e6, 1e6
"""A value that is further from the origin costs the others' digits in the sums, as long as it counts."""
LARGEST = 1e100
"""A value beyond it is no measurement, and its square no number."""


class Slope:
    """A regression line over a moving window."""

    __slots__ = (
        "_first",
        "_least",
        "_origin_ns",
        "_rebuild_at",
        "_samples",
        "_st",
        "_stt",
        "_stv",
        "_sv",
        "_v0",
        "_window",
    )

    def __init__(self, window_ns: int, least_ns: int = 0) -> None:
        """There is no line of samples that span less than `least_ns`."""
        self._window, self._least = float(window_ns), float(least_ns)
        self._samples: deque[tuple[float, float]] = deque()  # time from the origin, value
        self.reset()

    def reset(self) -> None:
        self._samples.clear()
        self._origin_ns = 0
        self._first = 0.0  # the time of the oldest sample, once there is one
        self._rebuild_at = REBUILD * self._window
        self._st = self._sv = self._stt = self._stv = self._v0 = 0.0

    def span(self, window_ns: int) -> None:
        """Have the window be so long from now on, and its samples span half of it at least."""
        self._window, self._least = float(window_ns), float(window_ns // 2)

    def __len__(self) -> int:
        return len(self._samples)

    @property
    def oldest_ns(self) -> int:
        """The time of the oldest sample in the window, once there is one."""
        return self._origin_ns + int(self._first)

    def add(self, time_ns: int, value: float) -> float | None:
        """Take in a sample, whose time does not go back; return the slope of the window that it ends.

        None where there is no line: of fewer than three samples, of too short a time, or all at one.
        """
        samples = self._samples
        v0 = self._v0
        if samples:
            t = (time_ns - self._origin_ns) * 1.0
            v = value - v0
            if not LOWEST < v < HIGHEST:
                if not abs(value) < LARGEST:
                    return None
                self._rebuild_at = min(self._rebuild_at, t + self._window)
        elif abs(value) < LARGEST:
            self._origin_ns, self._v0 = time_ns, value
            t = v = 0.0
        else:
            return None
        samples.append((t, value))
        st = self._st + t
        sv = self._sv + v
        stt = self._stt + t * t
        stv = self._stv + t * v
        last = t - self._window
        first = self._first
        if first <= last:
            now = t
            while first <= last:
                t, v = samples.popleft()
                v -= v0
                st -= t
                sv -= v
                stt -= t * t
                stv -= t * v
                first = samples[0][0]
            self._first = first
            t = now
        self._st = st
        self._sv = sv
        self._stt = stt
        self._stv = stv
        if t >= self._rebuild_at:
            self._rebuild()
            return self._line(t - first)
        n = len(samples)
        if n < 3 or t - first < self._least:
            return None
        stt *= n
        square = stt - st * st
        if square <= 1e-9 * stt:  # what is left of the sums may be rounding only
            if first:  # the origin can be nearer
                self._rebuild()
            return self._line(t - first)
        return (n * stv - st * sv) * 1e9 / square

    def _line(self, span: float) -> float | None:
        n, st = len(self._samples), self._st
        square = n * self._stt - st * st
        if n < 3 or span < self._least or square <= 0:
            return None
        return (n * self._stv - st * self._sv) * 1e9 / square

    def _rebuild(self) -> None:
        """Move the origin to the oldest sample, and add the sums up anew."""
        samples = self._samples
        t0, v0 = samples[0]
        self._v0 = v0
        self._origin_ns += int(t0)
        self._first = 0.0
        self._rebuild_at = REBUILD * self._window
        self._st = self._sv = self._stt = self._stv = 0.0
        for _ in range(len(samples)):
            t, value = samples.popleft()
            t -= t0
            v = value - v0
            if not LOWEST < v < HIGHEST:
                self._rebuild_at = min(self._rebuild_at, t + self._window)
            samples.append((t, value))
            self._st += t
            self._sv += v
            self._stt += t * t
            self._stv += t * v


DEC, CONST, INC = -1, 0, 1
PAST_NS = -(1 << 62)
PATIENCE = 0.1
"""How much of a trend's window may come all at once: its slope is wrong by as much, at most."""

STEPS, HOLDS = 3, 4
"""A window has so many steps of a value that moves in steps; so many of the newest say how long they are."""

LONGEST_STEP = 3
"""What holds for longer than so many windows stands, and jumps: that is no step."""

WORDS = {INC: "inc", DEC: "dec", CONST: "const"}


@dataclass(frozen=True)
class Trend:
    """When a value counts as increasing or decreasing.

    Attributes:
        window_s: the line is fitted over so many seconds.
        slope: b, in units of the value per second: above it the value increases, below −b it decreases.
        hysteresis: the part of b, from 0 to below 1, by which a trend may fall back before it ends.
        debounce_s: how long a new trend must last, in seconds.
        wraps_at: of an angle, the size of a full turn in the value's units: 360, or 6.28318530718.
        check_s: how often a verdict is given, in seconds; 0: with each sample.
    """

    window_s: float = 1.0
    slope: float = 0.05
    hysteresis: float = 0.2
    debounce_s: float = 0.0
    wraps_at: float | None = None
    check_s: float = 0.1

    PRESETS: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "published": {"window_s": 1.0, "slope": 5e-7, "hysteresis": 0.0, "check_s": 0.0}
    }

    def __post_init__(self) -> None:
        positive(window_s=self.window_s, slope=self.slope)
        if not 0 <= self.hysteresis < 1:
            raise ValueError(f"hysteresis must be from 0 to below 1, not {self.hysteresis:g}")
        for name in ("debounce_s", "check_s"):
            if not 0 <= getattr(self, name) <= 86400:
                raise ValueError(f"{name} must be from 0 to 86400, not {getattr(self, name):g}")
        if self.wraps_at is not None:
            positive(wraps_at=self.wraps_at)


class TrendOf:
    """The trend of one value, sample by sample."""

    def __init__(self, expected: Trend) -> None:
        self._window_ns = ns(expected.window_s)
        self._line = Slope(self._window_ns, self._window_ns // 2)
        self._add = self._line.add
        outer, inner = expected.slope, expected.slope * (1 - expected.hysteresis)
        # The trend that was told -> above which slope it is inc, below which dec.
        self._limits = {
            None: (outer, -outer),
            CONST: (outer, -outer),
            INC: (inner, -outer),
            DEC: (outer, -inner),
        }
        self._debounce_ns = ns(expected.debounce_s)
        self._grain_ns = 0
        self._holds: deque[int] = deque(maxlen=HOLDS)  # for how long the value stood between its newest steps
        self._stretched_ns = 0  # by so much is the window longer
        self._steps = False  # whether its values are whole numbers
        self._turn = expected.wraps_at
        self.reset()

    def reset(self, time_ns: int = 0) -> None:
        self._line.reset()
        self.now: int | None = None  # the trend
        self._upper, self._lower = self._limits[None]
        self._newest_ns = self._ends_ns = PAST_NS  # of the newest sample, and when it says nothing any more
        self._value, self._changed_ns, self._slope = math.nan, time_ns, 0.0
        self._repeated = self._stood = False
        self._whole_hold = False  # whether it was seen from its beginning: the first one began unseen
        self._raw: float | None = None
        self._unwrapped = 0.0
        self._next: int | None = None  # the trend that must last, and since when it does
        self._next_ns = 0

    @property
    def oldest_ns(self) -> int:
        """The time of the oldest sample that the trend rests on."""
        return min(self._line.oldest_ns, self._newest_ns - self._debounce_ns)

    def feed(self, source: str, time_ns: int, value: object) -> None:
        # Nearly all are floats, and finite: number() has nothing to say of them.
        reading = value if type(value) is float and value - value == 0.0 else number(value)
        if not self._newest_ns <= time_ns < self._ends_ns:
            if time_ns >= self._ends_ns or self._newest_ns - time_ns > self._window_ns:
                self.reset()  # a gap, or time went back: what was before is no part of this line
            else:
                time_ns = self._newest_ns
        self._newest_ns = time_ns
        self._ends_ns = time_ns + self._window_ns
        if self._turn is not None:
            reading = self._unwrap(reading, self._turn)
        slope = self._add(time_ns, reading)
        if reading == self._value:
            self._repeated = True
            self._stood = self._stood or time_ns > self._changed_ns
            if self._stretched_ns and time_ns - self._changed_ns > 2 * self._grain_ns:
                self._holds.clear()  # it stands, for longer than between steps
                self._stretch(0)
        else:
            if self._whole_hold and (self._repeated or self._holds):
                self._stepped(time_ns)
            first = math.isnan(self._value)
            self._stood = self._stood and self._repeated
            self._whole_hold = not first
            self._steps = type(value) is int
            self._value, self._changed_ns, self._repeated = reading, time_ns, False
        if slope is None or (self.now is None and self._may_step(time_ns)):
            return
        self._slope = slope
        trend = INC if slope > self._upper else DEC if slope < self._lower else CONST
        if trend == self.now:
            self._next = None
        elif not self._debounce_ns or self._lasts(trend, time_ns):
            self._next, self.now = None, trend
            self._upper, self._lower = self._limits[trend]

    @property
    def stretched_s(self) -> float:
        """By how many seconds the window is longer, for the value's steps."""
        return self._stretched_ns / SECOND

    @property
    def steps_within_s(self) -> float:
        """How long it may take after a reset, besides, until a step is seen as a whole, or it stands."""
        unknown = self._steps and self._stood and not self._holds
        return (2 * LONGEST_STEP - 1) * self._window_ns / SECOND if unknown else 0.0

    def _may_step(self, time_ns: int) -> bool:
        """Whether it stood, and may do so between two steps, of which none was seen as a whole yet."""
        longest_ns = LONGEST_STEP * self._window_ns
        return self._steps and self._stood and not self._holds and time_ns - self._changed_ns < longest_ns

    def _stepped(self, time_ns: int) -> None:
        """The value has changed: how long did it stand before, again and again?"""
        held_ns = time_ns - self._changed_ns if self._repeated else 0
        if held_ns > LONGEST_STEP * self._window_ns:  # between two jumps it stood
            self._holds.clear()
            self._stretch(0)
            return
        self._holds.append(held_ns)
        longest = sorted(self._holds)
        # One long hold is no step: it stood, and moves now.
        grain_ns = longest[-2] if len(longest) > 1 else longest[0]
        if not longest[-1]:
            self._holds.clear()
        self._stretch(grain_ns)

    def _stretch(self, grain_ns: int) -> None:
        self._grain_ns = grain_ns
        self._stretched_ns = max(0, STEPS * grain_ns - self._window_ns)
        self._line.span(self._window_ns + self._stretched_ns)

    def _lasts(self, trend: int, time_ns: int) -> bool:
        """Return whether a new trend has lasted for long enough."""
        if trend != self._next:
            self._next, self._next_ns = trend, time_ns
        return time_ns - self._next_ns >= self._debounce_ns

    def _unwrap(self, value: float, turn: float) -> float:
        """Return the value without the jumps of full turns."""
        if self._raw is None:
            self._unwrapped = value
        else:
            step = (value - self._raw) % turn
            self._unwrapped += step - turn if step > turn / 2 else step
        self._raw = value
        return self._unwrapped


class QualitativeObserver(TrendOf):
    """Watches the trend of one value."""

    def __init__(self, value: str, source: str, expected: Trend | None = None) -> None:
        """
        Args:
            value: the model's name of the value, as in inc(value); by default the entry's name.
            source: topic and field, e.g. `odom:twist.twist.linear.x`.
            expected: of its trend.
        """
        expected = expected or Trend()
        super().__init__(expected)
        self.sources = frozenset((source,))
        atoms = {trend: Atom(word, (value,)) for trend, word in WORDS.items()}
        self.atoms = tuple(atoms.values())
        self.period_ns = ns(expected.check_s)
        self._delay_s = expected.window_s + expected.debounce_s + expected.check_s
        self.patience_s = PATIENCE * expected.window_s
        self._said: dict[int | None, tuple[Literal, ...]] = {
            trend: tuple(Literal(atom, trend == other) for other, atom in atoms.items()) for trend in atoms
        }
        self._said[None] = NOTHING

    @property
    def detection_s(self) -> float:
        return self._delay_s + self.stretched_s

    @property
    def settling_s(self) -> float:
        return self.detection_s + self.steps_within_s

    def due_ns(self) -> int | None:
        ends_ns = self._ends_ns
        return None if ends_ns == PAST_NS else ends_ns

    def check(self, now_ns: int) -> tuple[Literal, ...]:
        return NOTHING if now_ns >= self._ends_ns else self._said[self.now]

    def evidence(self, atom: Atom, now_ns: int) -> Evidence:
        if self.now == CONST and self._newest_ns - self._changed_ns >= self._window_ns // 2:
            reading = Reading(f"stands still at {self._value:g}", symptom=Symptom.STILL)
        else:
            reading = Reading(float(f"{self._slope:.3g}"), "per s", f"± {self._limits[None][0]:g} is const")
        return Evidence(self.oldest_ns, None, reading)
