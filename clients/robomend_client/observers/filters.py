"""Filters: a number in, a smoother one out, and since when its samples are.

    none      the sample itself
    mean      of the newest `window` samples
    median    of the newest `window` samples; an outlier has no weight at all
    ewma      v ← v + decay·(x − v), beginning with the first sample

A mean and a median speak from the first sample on, of what there is. Every cost is O(1) a sample, the
median's O(log n + n) with a very small n: it keeps its window sorted.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import deque
from dataclasses import dataclass
from math import fsum, log
from typing import Protocol

FILTERS = ("none", "mean", "median", "ewma")

REBUILD = 4096
"""Samples after which a running sum is added up anew: rounding errors do not add up for ever."""


@dataclass(frozen=True)
class Filter:
    """Which filter; the defaults leave samples as they are.

    Attributes:
        filter: what smooths the readings: `none`, `mean`, `median` or `ewma`.
        filter_window: of so many samples a mean or a median is taken.
        filter_decay: of ewma, the weight of the newest sample, above 0 and at most 1.
    """

    filter: str = "none"
    filter_window: int = 5
    filter_decay: float = 0.3

    def __post_init__(self) -> None:
        if self.filter not in FILTERS:
            raise ValueError(f"filter must be one of {', '.join(FILTERS)}, not {self.filter!r}")
        if not 1 <= self.filter_window <= 100_000:
            raise ValueError(f"filter_window must be from 1 to 100000, not {self.filter_window}")
        if not 0 < self.filter_decay <= 1:
            raise ValueError(f"filter_decay must be above 0 and at most 1, not {self.filter_decay:g}")

    @property
    def samples(self) -> int:
        """How many samples it takes until a step of the value has come through, nearly (95 %)."""
        if self.filter == "none":
            return 1
        if self.filter == "ewma":
            return 1 if self.filter_decay == 1 else max(1, round(log(0.05) / log(1 - self.filter_decay)))
        return self.filter_window

    def make(self) -> Smoothing:
        """Return a fresh one."""
        if self.filter == "mean":
            return Mean(self.filter_window)
        if self.filter == "median":
            return Median(self.filter_window)
        return Ewma(self.filter_decay if self.filter == "ewma" else 1.0, self.samples)


class Smoothing(Protocol):
    """A filter at work."""

    def add(self, time_ns: int, value: float) -> float:
        """Take in a sample; return the filtered value."""
        ...

    @property
    def since_ns(self) -> int:
        """The time of the oldest sample that the filtered value rests on."""
        ...

    def reset(self) -> None:
        """Forget all samples."""
        ...


class Mean:
    """The mean of a window."""

    def __init__(self, window: int) -> None:
        self._window: deque[tuple[int, float]] = deque()
        self._size = window
        self.reset()

    def reset(self) -> None:
        self._window.clear()
        self._sum = 0.0
        self._since_rebuilt = 0

    @property
    def since_ns(self) -> int:
        return self._window[0][0]

    def add(self, time_ns: int, value: float) -> float:
        window = self._window
        window.append((time_ns, value))
        self._sum += value
        if len(window) > self._size:
            self._sum -= window.popleft()[1]
        self._since_rebuilt += 1
        if self._since_rebuilt >= REBUILD:
            self._sum = fsum(value for _, value in window)
            self._since_rebuilt = 0
        return self._sum / len(window)


class Median:
    """The median of a window; of an even number of samples the mean of the middle two."""

    def __init__(self, window: int) -> None:
        self._window: deque[tuple[int, float]] = deque()
        self._sorted: list[float] = []
        self._size = window

    def reset(self) -> None:
        self._window.clear()
        self._sorted.clear()

    @property
    def since_ns(self) -> int:
        return self._window[0][0]

    def add(self, time_ns: int, value: float) -> float:
        self._window.append((time_ns, value))
        ordered = self._sorted
        insort(ordered, value)
        if len(self._window) > self._size:
            del ordered[bisect_left(ordered, self._window.popleft()[1])]
        middle = len(ordered) // 2
        return ordered[middle] if len(ordered) % 2 else (ordered[middle - 1] + ordered[middle]) / 2


class Ewma:
    """An exponentially weighted moving average; with a decay of 1 the sample itself."""

    def __init__(self, decay: float, samples: int) -> None:
        self._decay = decay
        self._times: deque[int] = deque(maxlen=samples)
        self._value: float | None = None

    def reset(self) -> None:
        self._times.clear()
        self._value = None

    @property
    def since_ns(self) -> int:
        """The oldest sample that still has any weight to speak of (5 %)."""
        return self._times[0]

    def add(self, time_ns: int, value: float) -> float:
        self._times.append(time_ns)
        if self._value is None or self._decay == 1.0:
            self._value = value
        else:
            self._value += self._decay * (value - self._value)
        return self._value
