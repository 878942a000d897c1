"""The node observer (NObs): running(n) while node n runs, not running(n) otherwise.

It is fed the names of the nodes that run; where they come from (a process table, a ROS master, DDS discovery)
is the feeder's business. It says nothing before it was fed once.

Source: the paper, section IV-B; 10 Hz as published.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

from robomend_client.literals import Literal, fails, holds
from robomend_client.observers.base import ns

PROCESSES = "processes"
"""The source whose values are collections of the names of running nodes."""


class NodeObserver:
    """Watches whether nodes run."""

    def __init__(self, nodes: Iterable[str], rate_hz: float = 10.0) -> None:
        if not rate_hz > 0:
            raise ValueError(f"rate_hz must be above 0, not {rate_hz}")
        self.nodes = tuple(sorted(set(nodes)))
        self._period_ns = ns(1.0 / rate_hz)
        self._running: frozenset[str] | None = None

    @property
    def sources(self) -> frozenset[str]:
        return frozenset((PROCESSES,))

    @property
    def period_ns(self) -> int:
        return self._period_ns

    def feed(self, source: str, time_ns: int, value: object) -> None:
        """The nodes in `value` run, and no others."""
        if not isinstance(value, Collection) or isinstance(value, str):
            raise TypeError(f"the names of running nodes are a collection, not {value!r}")
        self._running = frozenset(str(name) for name in value)

    def check(self, now_ns: int) -> tuple[Literal, ...]:
        if self._running is None:
            return ()
        return tuple(
            holds("running", node) if node in self._running else fails("running", node) for node in self.nodes
        )
