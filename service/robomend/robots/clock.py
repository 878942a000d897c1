"""The clock of the process, by which OBS is ordered and grows stale.

After a restart it begins no earlier than what a robot's OBS holds.
"""

from __future__ import annotations

import time

import structlog

from robomend_client.clock import Clock

log = structlog.get_logger("robomend.robots.clock")

AHEAD_NS = 60 * 10**9
"""How far in the future a client's clock may be: an entry from the future outlives everything older."""


class ServiceClock(Clock):
    """The service's clock; it notices, and says once, that the computer's was set back."""

    def __init__(self) -> None:
        super().__init__()
        self._told = False

    def set_back_ns(self, now_ns: int) -> int:
        """Return how far the computer's clock was set back, as long as this one is ahead; 0: not far.

        Args:
            now_ns: what this clock has just said.
        """
        ahead_ns = now_ns - time.time_ns()
        if ahead_ns <= AHEAD_NS:
            self._told = False
            return 0
        if not self._told:
            self._told = True
            log.warning("clock jumped", source="this computer", behind_s=round(ahead_ns / 1e9))
        return ahead_ns


CLOCK = ServiceClock()
