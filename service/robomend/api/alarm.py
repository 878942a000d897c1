"""A time-out for what begins and ends again and again, and nearly always in time.

A timer of the event loop for each of them costs more than what it watches. So one timer runs on: when it runs
out, it looks since when something is under way, and is set anew for the rest.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from types import TracebackType


class Alarm:
    """Rings when what began has not ended after so long. A context: outside of it nothing rings."""

    def __init__(self, after_s: float, ring: Callable[[], object]) -> None:
        self.rang = False
        """Whether it rang for what began last."""
        self._after_s = after_s
        self._ring = ring
        self._since_s: float | None = None  # monotonic; None: nothing is under way
        self._timer: asyncio.TimerHandle | None = None

    def __enter__(self) -> Alarm:
        self._look_in(self._after_s)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def begin(self) -> None:
        """Something begins."""
        self._since_s = time.monotonic()
        self.rang = False

    def end(self) -> None:
        """It has ended."""
        self._since_s = None

    def _look_in(self, delay_s: float) -> None:
        self._timer = asyncio.get_running_loop().call_later(delay_s, self._look)

    def _look(self) -> None:
        left_s = self._after_s
        if self._since_s is not None:
            left_s -= time.monotonic() - self._since_s
        if left_s <= 0:
            self._since_s, self.rang, left_s = None, True, self._after_s
            self._look_in(left_s)
            self._ring()
        else:
            self._look_in(left_s)
