"""Robots first: a page is made in slices, and between two of them whatever a robot wants is served.

    slice ──► what is ready on the event loop ──► a batch under way? ── no ──► slice
                                                       │ yes
                                                       └─► wait, but for `MOST_S` a page in all

A page takes some 7 ms of the event loop that also answers robots: made in one go, it is in the way of every
change that comes meanwhile, and with fifty pages open that is each fifth change. One page is made at a time;
more would each put a slice between two steps of a change.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager

SLICE_S = 0.001
"""Of the event loop, without looking up."""

MOST_S = 0.04
"""What robots may hold up one page: at `PER_S` (robomend.web.page_pace), all pages of a busy fleet come."""

PAUSE_S = 0.001

AT_ONCE = 5
"""Pages that follow an event are made at once; of more that ask together, one each `APART_S`."""

APART_S = 0.03

LONGEST_S = 1.0
"""Nobody waits longer for a place, however many ask."""

STEPS = 2
"""Rounds of the event loop from the first byte of a batch until it is counted."""


class PageTurn:
    """The making of one page."""

    def __init__(self, under_way: Callable[[], int]) -> None:
        self._under_way = under_way
        self._left_s = MOST_S
        self._until_s = time.perf_counter() + SLICE_S

    async def slice(self) -> None:
        """Let others go first, if this slice is over."""
        if time.perf_counter() >= self._until_s:
            await self.others()

    async def others(self) -> None:
        """Let others go first."""
        for _ in range(STEPS):
            await asyncio.sleep(0)
        while self._left_s > 0 and self._under_way():
            began = time.perf_counter()
            await asyncio.sleep(PAUSE_S)
            self._left_s -= time.perf_counter() - began
        self._until_s = time.perf_counter() + SLICE_S

    async def joined(self, pieces: Iterable[str]) -> str:
        """Return the pieces as one text, made as far as a slice goes at a time."""
        made = []
        for piece in pieces:
            made.append(piece)
            await self.slice()
        return "".join(made)


class PageTurns:
    """One page after another. Belongs to one event loop."""

    def __init__(self, under_way: Callable[[], int]) -> None:
        """`under_way` counts the batches that are being kept."""
        self._under_way = under_way
        self._one = asyncio.Lock()
        self._next_s = 0.0

    async def apart(self) -> None:
        """Wait for a place, where many pages ask together: the first change of a fleet concerns all of them,
        and fifty in one go are a third of a second in which each change of a robot is late.
        """
        now_s = time.monotonic()
        self._next_s = min(max(now_s, self._next_s) + APART_S, now_s + LONGEST_S)
        wait_s = self._next_s - now_s - AT_ONCE * APART_S
        if wait_s > 0:
            await asyncio.sleep(wait_s)

    async def others(self) -> None:
        """Let robots, and the pages before, go first."""
        async with self.turn():
            pass

    @asynccontextmanager
    async def turn(self) -> AsyncIterator[PageTurn]:
        """Wait for the pages before, and for robots."""
        async with self._one:
            turn = PageTurn(self._under_way)
            await turn.others()
            yield turn
