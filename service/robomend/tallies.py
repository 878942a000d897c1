"""Counters and histograms that cost next to nothing to count in; Prometheus' objects are made when asked for.

prometheus_client's own take a lock, check whether they may be counted in and look a label up: for what is
counted with each of a thousand batches a second that is more than the counting. Each child of these belongs
to one thread; whoever collects reads numbers that are whole.
"""

from __future__ import annotations

from abc import abstractmethod
from bisect import bisect_left
from collections.abc import Iterable, Sequence
from itertools import accumulate
from typing import Generic, TypeVar

from prometheus_client.core import CounterMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.registry import Collector


class Tally:
    """A count that grows."""

    __slots__ = ("count",)

    def __init__(self) -> None:
        self.count = 0

    def inc(self, by: int = 1) -> None:
        """Count."""
        self.count += by


class Spread:
    """How many values there were up to each bound, and their sum."""

    __slots__ = ("bounds", "counts", "total")

    def __init__(self, bounds: Sequence[float]) -> None:
        self.bounds = bounds
        self.counts = [0] * (len(bounds) + 1)
        self.total = 0.0

    def observe(self, value: float) -> None:
        """Count a value."""
        self.counts[bisect_left(self.bounds, value)] += 1
        self.total += value


Child = TypeVar("Child", Tally, Spread)


class _Family(Collector, Generic[Child]):
    """Children of one name, by the values of their labels."""

    def __init__(self, name: str, text: str, labels: Sequence[str] = ()) -> None:
        self._name, self._text, self._labelnames = name, text, labels
        self._children: dict[tuple[str, ...], Child] = {}

    def labels(self, *values: str) -> Child:
        """Return the child with these values; one that counts often is kept by whoever counts."""
        child = self._children.get(values)
        if child is None:
            child = self._children.setdefault(values, self._new())
        return child

    @abstractmethod
    def _new(self) -> Child: ...

    def describe(self) -> Iterable[Metric]:
        """Nothing is there yet; the registry asks for names."""
        return self.collect()


class Tallies(_Family[Tally]):
    """A counter of Prometheus; see the module."""

    def _new(self) -> Tally:
        return Tally()

    def collect(self) -> Iterable[Metric]:
        family = CounterMetricFamily(self._name, self._text, labels=self._labelnames)
        for values, tally in tuple(self._children.items()):
            family.add_metric(values, tally.count)
        return [family]


class Spreads(_Family[Spread]):
    """A histogram of Prometheus; see the module."""

    def __init__(self, name: str, text: str, labels: Sequence[str] = (), *, bounds: Sequence[float]) -> None:
        super().__init__(name, text, labels)
        self._bounds = bounds
        if not labels:
            self.labels()  # it is shown from the start

    def _new(self) -> Spread:
        return Spread(self._bounds)

    def collect(self) -> Iterable[Metric]:
        family = HistogramMetricFamily(self._name, self._text, labels=self._labelnames)
        names = [*map(str, self._bounds), "+Inf"]
        for values, spread in tuple(self._children.items()):
            buckets = [*zip(names, map(float, accumulate(spread.counts)), strict=True)]
            family.add_metric(values, buckets, sum_value=spread.total)
        return [family]
