"""The slope of the newest samples: least squares over a window of time, in O(1) a sample.

    slope = (n Σtv − Σt Σv) / (n Σt² − (Σt)²)

Times and values are taken relative to an origin that moves with the window, and the sums are added up anew
every REBUILD windows, and when a value that dwarfs the others has left: so that rounding neither grows with
the age of the robot nor with the size of the value. Times are nanoseconds, as whole numbers that a float
holds exactly.
"""

from __future__ import annotations

from collections import deque

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
