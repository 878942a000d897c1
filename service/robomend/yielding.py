"""Long work on the event loop, cut into turns: between two of them everybody else gets theirs.

For work that is many small steps, each of which must be done here. What is one long step, or may become one,
belongs into a worker process (robomend.workers).
"""

from __future__ import annotations

import asyncio
import time

TURN_S = 0.002
"""Of one turn: others wait a little longer than this, and few requests need a second one."""


class Turns:
    """One piece of work; `await turns.rest()` between its steps."""

    __slots__ = ("_began",)

    def __init__(self) -> None:
        self._began = time.perf_counter()

    @property
    def over(self) -> bool:
        """Whether this turn has lasted long enough."""
        return time.perf_counter() - self._began >= TURN_S

    async def rest(self) -> None:
        """Let others go on if this turn is over."""
        if self.over:
            await self.end()

    async def end(self) -> None:
        """Let others go on: what comes next counts its turns itself."""
        await asyncio.sleep(0)
        self._began = time.perf_counter()
