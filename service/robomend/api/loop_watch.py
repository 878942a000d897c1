"""How late the event loop is: what every request waits before it begins.

The loop ticks every 25 ms, by a timer of its own. How late a tick comes is measured, and logged where
it is much. Whoever looks from another thread (health and readiness, on the control lane) sees how long the
tick is overdue.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque

import structlog

from robomend.metrics import Metrics

log = structlog.get_logger("robomend.loop")

EVERY_S = 0.025
"""Between two ticks."""

HELD_S = 0.05
"""A delay that is told in the log."""

DELAYS = 40
"""Of the latest ticks, kept: a second's."""

FROZEN_S = 10.0
"""Without a tick for so long, the process is of no use."""


class LoopWatch:
    """See the module. Ticks on one event loop; its properties are for any thread."""

    def __init__(self, metrics: Metrics) -> None:
        self._metrics = metrics
        self._watched_loop: asyncio.AbstractEventLoop | None = None
        self._due_s = time.monotonic()  # of the next tick
        self._timer: asyncio.TimerHandle | None = None
        self._delays: deque[float] = deque(maxlen=DELAYS)
        self._usual_s = 0.0  # their median
        self._worst_s = 0.0
        metrics.on_demand(
            "robomend_loop_delay_worst_seconds",
            "the longest that the event loop was held since the start",
            (),
            lambda: [((), max(self._worst_s, self.held_s))],
        )

    def start(self) -> None:
        """Watch the running event loop from now on."""
        self._watched_loop = asyncio.get_running_loop()
        self._wait()

    def close(self) -> None:
        """End the ticks; to be called by the event loop."""
        if self._timer is not None:
            self._timer.cancel()

    @property
    def loop(self) -> asyncio.AbstractEventLoop:
        """The event loop that is watched: the service's own."""
        assert self._watched_loop is not None
        return self._watched_loop

    @property
    def held_s(self) -> float:
        """How long ago the last tick was; under EVERY_S means nothing."""
        return time.monotonic() - self._due_s + EVERY_S

    @property
    def frozen(self) -> bool:
        """Whether the loop has not turned for so long that nobody should wait for it."""
        return self.held_s > FROZEN_S

    @property
    def delay_s(self) -> float:
        """The delay of the ticks lately (median of a second), or of the one that is awaited."""
        return max(self._usual_s, self.held_s - EVERY_S)

    def _wait(self) -> None:
        self._due_s = time.monotonic() + EVERY_S
        self._timer = self.loop.call_later(EVERY_S, self._tick)

    def _tick(self) -> None:
        delay_s = max(0.0, time.monotonic() - self._due_s)
        self._delays.append(delay_s)
        self._usual_s = sorted(self._delays)[len(self._delays) // 2]
        self._worst_s = max(self._worst_s, delay_s)
        self._metrics.loop_delay_s.observe(delay_s)
        if delay_s > HELD_S:
            log.warning("event loop held", ms=round(delay_s * 1000))
        self._wait()
