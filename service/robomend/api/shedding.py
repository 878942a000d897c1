"""Load shedding: a batch that could not be answered in time is refused at once, with a 503 and Retry-After.

    expected delay = batches under way × time for each place in the queue + how late the event loop is

The time for a place is measured (Little's law): what the latest batches took, over how many were under way
when each began. A slow disk, other work on the machine and expensive batches are all in it. Without a bound
the queue of an overloaded service grows without end, and everybody waits for ten seconds, the repairs too.

The edge asks here before anything else is done with a batch: refusing must cost little, or it is an overload
of its own. It is asked once more when the batch has been read, if others may have come meanwhile.

A few batches are always let in, so that the measure stays current; none while the disk hangs. Stop, health
and readiness are never asked here.

References:
    J. D. C. Little. A proof for the queuing formula L = λW. Operations Research 9(3), 1961.
    K. Nichols, V. Jacobson. Controlling queue delay. ACM Queue 10(5), 2012: a target, and bursts that pass.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import inf

import structlog

from robomend.api.problems import Problem
from robomend.metrics import Metrics

log = structlog.get_logger("robomend.shedding")

TARGET_S = 0.2
"""An expected delay that is longer, for longer than BURST_S, is an overload. What waits before
this is asked, and the sending, come on top of it.
"""

BURST_S = 0.5
"""A stall passes: what gathered meanwhile is kept, not refused."""

MOST_S = 0.6
"""… unless it would wait for so long."""

CALM_S = 1.0
"""Without too long a delay, after which an overload is over."""

ALWAYS = 16
"""Batches under way that are always let in."""

HANGS_S = 1.0
"""The oldest write in the queue waits for so long: the disk hangs, or cannot keep up."""

MEMORY = 1 / 256
"""The weight of the latest batch in the measure."""

MEANWHILE_S = 0.001
"""What takes longer may have let others go on."""

GUESS_S = 0.001
"""For a place, before anything was measured."""


class LoadShedding:
    """See the module. Belongs to one event loop."""

    def __init__(
        self, oldest_write_s: Callable[[], float], loop_delay_s: Callable[[], float], metrics: Metrics
    ) -> None:
        """Both functions are asked for each batch."""
        self._oldest_write_s = oldest_write_s
        self._loop_delay_s = loop_delay_s
        self._refused = metrics.refused.labels("overload")
        self.under_way = 0
        """Batches that are being kept."""
        self._began_s = self._over_s = -CALM_S  # the present overload, or the one before
        self._took_s, self._places = GUESS_S, 1.0  # sums; the older, the less they weigh
        metrics.on_demand(
            "robomend_expected_delay_seconds",
            "what a batch of observations would wait now",
            (),
            lambda: [((), self.delay_s)],
        )

    @property
    def delay_s(self) -> float:
        """What a batch would wait that comes now."""
        return self.under_way * self._took_s / self._places + self._loop_delay_s()

    def refusal(self) -> Problem | None:
        """Return why a batch that comes now is refused, or None."""
        oldest_s = self._oldest_write_s()
        if oldest_s > HANGS_S:
            return self._refuse(f"a write has been waiting for the disk for {oldest_s:.1f} s; try again")
        if self.under_way >= ALWAYS and self._too_long(delay_s := self.delay_s):
            return self._refuse(
                f"more observations come than can be kept: {self.under_way} batches are under way, and"
                f" another would wait for {delay_s:.1f} s; try again"
            )
        return None

    def _too_long(self, delay_s: float) -> bool:
        """Whether a batch is not to wait for so long."""
        if delay_s <= TARGET_S:
            return False
        now = time.monotonic()
        if now - self._over_s > CALM_S:
            self._began_s = now
        self._over_s = now
        return delay_s > MOST_S or now - self._began_s > BURST_S

    def _refuse(self, why: str) -> Problem:
        self._refused.inc()
        log.warning("load shed", why=why)
        return Problem(503, why)

    @contextmanager
    def one(self, since_s: float = inf) -> Iterator[None]:
        """Count a batch in while it is kept.

        Args:
            since_s: so long ago the edge has asked.

        Raises:
            Problem: while it was read, so many others came that it would wait too long.
        """
        if since_s > MEANWHILE_S and (late := self.refusal()) is not None:
            raise late
        self.under_way += 1
        place, began = self.under_way, time.perf_counter()
        try:
            yield
        finally:
            self.under_way -= 1
            self._took_s += time.perf_counter() - began - self._took_s * MEMORY
            self._places += place - self._places * MEMORY
