"""Waiting for a number to grow: how long polls and the repair loop wait for OBS and diagnoses."""

from __future__ import annotations

import asyncio


class Turnstile:
    """A number that only grows, and those who wait for it. Belongs to one event loop."""

    __slots__ = ("_waiters", "value")

    def __init__(self, value: int = 0) -> None:
        self.value = value
        self._waiters: set[asyncio.Future[None]] = set()

    @property
    def awaited(self) -> bool:
        """Whether anybody waits."""
        return bool(self._waiters)

    def advance(self, value: int) -> None:
        """Let everyone through who waits for this or less."""
        if value > self.value:
            self.value = value
            self.wake()

    def wake(self) -> None:
        """Let everyone look again."""
        if self._waiters:
            for waiter in self._waiters:
                if not waiter.done():
                    waiter.set_result(None)
            self._waiters.clear()

    async def beyond(self, value: int, timeout_s: float) -> int:
        """Return the number once it is above `value`, or whatever it is after the time-out or a wake."""
        if self.value > value:
            return self.value
        waiter = asyncio.get_running_loop().create_future()
        self._waiters.add(waiter)
        try:
            async with asyncio.timeout(timeout_s):
                await waiter
        except TimeoutError:
            pass
        finally:
            self._waiters.discard(waiter)
        return self.value
