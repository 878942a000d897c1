"""Work that is looked for again and again, as events tell of it: repairs, drills, batches, notifications.

An event wakes whoever looks; the period is for an event that was lost, or was another process's, which died.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Iterable

import structlog

from robomend.errors import RobomendError

log = structlog.get_logger("robomend.poller")


async def wait_for(change: asyncio.Event, timeout_s: float) -> None:
    """Wait for a change, but not longer."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(timeout_s):
            await change.wait()


class Seeker:
    """One task that looks, whatever a look meets; belongs to one event loop.

    Args:
        look: begins what there is to do; it may return after how many seconds to look again.
        what: what is looked for, for the log.
        period_s: after how many seconds to look again at the latest, also when a look failed.
    """

    def __init__(self, look: Callable[[], Awaitable[float | None]], what: str, period_s: float) -> None:
        self._look = look
        self._what = what
        self._period_s = period_s
        self._changed = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Look now, and from now on."""
        self._task = asyncio.create_task(self._run(), name=f"looking for {self._what}")

    def wake(self) -> None:
        """Something happened: look at once, and once more if a look is under way."""
        self._changed.set()

    async def close(self, tasks: Iterable[asyncio.Task[None]], within_s: float) -> None:
        """Look no more, and cancel the tasks that the looks began; wait for them, but not longer."""
        ending = [*tasks, *([self._task] if self._task else [])]
        for task in ending:
            task.cancel()
        if ending:
            await asyncio.wait(ending, timeout=within_s)

    async def _run(self) -> None:
        while True:
            self._changed.clear()
            pause_s: float | None = None
            try:
                pause_s = await self._look()
            except RobomendError as error:  # the database may be away for a while
                log.warning("looking", what=self._what, code=error.code, detail=str(error))
            except Exception:  # else nothing would ever be found again
                log.exception("looking", what=self._what)
            await wait_for(self._changed, self._period_s if pause_s is None else pause_s)
