"""The slope of the newest samples: least squares over a window of time, in O(1) a sample.

    slope = (n Σtv − Σt Σv) / (n Σt² − (Σt)²)

Times and values are taken relative to an origin that moves with the window, and the sums are added up anew
every REBUILD samples, so that rounding neither grows with the age of the robot nor with the size of the
value.
"""

from __future__ import annotations

from collections import deque

REBUILD = 4096
SMALLEST, LARGEST = -1e100, 1e100
"""A value beyond them is no measurement, and its square no number."""


class Slope:
    """A regression line over a moving window."""

    __slots__ = (
        "_age",
        "_n",
        "_origin_ns",
        "_samples",
        "_st",
        "_stt",
        "_stv",
        "_sv",
        "_v0",
        "oldest_ns",
        "window_ns",
    )

    def __init__(self, window_ns: int) -> None:
        self.window_ns = window_ns
        self._samples: deque[tuple[int, float, float]] = deque()  # time; time and value from the origin
        self.reset()

    def reset(self) -> None:
        self._samples.clear()
        self._n = self._age = self._origin_ns = 0
        self.oldest_ns = 0  # the time of the oldest sample in the window, once there is one
        self._st = self._sv = self._stt = self._stv = self._v0 = 0.0

    def __len__(self) -> int:
        return self._n

    def add(self, time_ns: int, value: float) -> float | None:
        """Take in a sample, whose time does not go back; return the slope of the window that it ends.

        None where there is no line: of fewer than three samples, or of samples all at one time.
        """
        if not SMALLEST < value < LARGEST:
            return None
        samples = self._samples
        if not samples:
            self._origin_ns, self._v0 = time_ns, value
            self.oldest_ns = time_ns
        t = (time_ns - self._origin_ns) * 1e-9
        v = value - self._v0
        samples.append((time_ns, t, v))
        n = self._n + 1
        st = self._st + t
        sv = self._sv + v
        stt = self._stt + t * t
        stv = self._stv + t * v
        last_ns = time_ns - self.window_ns
        if self.oldest_ns <= last_ns:
            oldest_ns = last_ns
            while oldest_ns <= last_ns:
                _, t, v = samples.popleft()
                n -= 1
                st -= t
                sv -= v
                stt -= t * t
                stv -= t * v
                oldest_ns = samples[0][0]
            self.oldest_ns = oldest_ns
        self._n = n
        self._st = st
        self._sv = sv
        self._stt = stt
        self._stv = stv
        self._age += 1
        if self._age >= REBUILD:
            self._rebuild()
            return self._line()
        if n < 3:
            return None
        stt *= n
        square = stt - st * st
        if square <= 1e-9 * stt:  # what is left of the sums may be rounding only
            self._rebuild()
            return self._line()
        return (n * stv - st * sv) / square

    def _line(self) -> float | None:
        n, st = self._n, self._st
        square = n * self._stt - st * st
        return (n * self._stv - st * self._sv) / square if n >= 3 and square > 0 else None

    def _rebuild(self) -> None:
        """Move the origin to the oldest sample, and add the sums up anew."""
        self._age = 0
        samples = self._samples
        origin_ns, _, v0 = samples[0]
        self._v0 += v0
        self._origin_ns = origin_ns
        self._st = self._sv = self._stt = self._stv = 0.0
        for _ in range(len(samples)):
            time_ns, _, v = samples.popleft()
            t = (time_ns - origin_ns) * 1e-9
            v -= v0
            samples.append((time_ns, t, v))
            self._st += t
            self._sv += v
            self._stt += t * t
            self._stv += t * v
