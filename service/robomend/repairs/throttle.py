"""Doing a thing at most every so often, for what comes in as often as it likes."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Hashable
from typing import Generic, TypeVar

import structlog

log = structlog.get_logger("robomend.repairs.throttle")

Key = TypeVar("Key", bound=Hashable)


class Throttle(Generic[Key]):
    """Does it at once, and then for the latest of what came meanwhile, for each key by itself.

    A failure is logged and not tried again: what comes next says more.
    """

    def __init__(self, period_s: float, do: Callable[[Key], Awaitable[None]]) -> None:
        """`do` finds out by itself what is the latest."""
        self._period_s = period_s
        self._do = do
        self._tasks: dict[Key, asyncio.Task[None]] = {}
        self._asked: set[Key] = set()

    def ask(self, key: Key) -> None:
        """Have it done: now, or when the period after the last time is over."""
        self._asked.add(key)
        if key not in self._tasks:
            task = self._tasks[key] = asyncio.create_task(self._run(key), name=f"telling of {key}")
            task.add_done_callback(lambda _: self._tasks.pop(key, None))

    async def close(self) -> None:
        """Do nothing more; what is under way is given up."""
        tasks = tuple(self._tasks.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _run(self, key: Key) -> None:
        while key in self._asked:
            self._asked.discard(key)
            try:
                await self._do(key)
            except Exception as error:  # noqa: BLE001  # whatever `do` may raise
                log.warning("not sent", what=str(key), detail=f"{type(error).__name__}: {error}")
            await asyncio.sleep(self._period_s)
