"""Tries whether the store reads and writes; an answer never waits for it.

    every second, asked or not     the lock of all writers: another process may keep it, and hang
    when somebody asks             a read, and a write to the disk

What takes long goes on, and the answer says what is known of it by then: what failed last counts until it
succeeds, and a probe that has had no answer for HANGS_S says that the database hangs. How long the oldest
write has been waiting, these among them, is in the store's figures (routers/operation.py). A file that was
found damaged stays so, whatever can still be read of it; a disk that had no room for somebody's write is
full for a while, though what the probe writes may still fit.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque

import structlog

from robomend.api.schemas.base import Out
from robomend.errors import RobomendError, StoreDamaged, StoreFull
from robomend.metrics import Metrics
from robomend.store import Store, global_stop


class Check(Out):
    """How one part is."""

    ok: bool
    detail: str


# --- how late the event loop is: what every request waits before it begins
# The loop ticks every 25 ms, by a timer of its own. How late a tick comes is measured, and logged where
# it is much. Whoever looks from another thread (health and readiness, on the control lane) sees how long the
# tick is overdue.

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


ANSWER_S = 0.02
"""For the probe; an answer does not wait longer."""

HANGS_S = 2.0
"""A probe without an answer for so long hangs."""

FRESH_S = 1.0
"""A probe's answer counts so long, so that a hundred who ask write once."""

TURN_S = 1.0
"""Between two looks whether there is a turn to write."""


class StoreProbe:
    """See the module. Belongs to the store's event loop."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._probing: asyncio.Task[Check] | None = None
        self._begun_s = 0.0
        self._found = self._turn = Check(ok=True, detail="")
        self._found_s = float("-inf")
        self._watching: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Look every second whether there is a turn to write."""
        self._watching = asyncio.create_task(self._watch(), name="turns to write")

    @property
    def known(self) -> Check:
        """How the store is, as far as that is known now; for any thread."""
        if (damage := self._store.damage) is not None:
            return Check(ok=False, detail=f"{StoreDamaged.code}: {damage}")
        if (full := self._store.full) is not None:
            return Check(ok=False, detail=f"{StoreFull.code}: {full}")
        if self._probing is not None and (hung_s := time.monotonic() - self._begun_s) > HANGS_S:
            return Check(ok=False, detail=f"no answer to a read and a write in {hung_s:.0f} s")
        return self._found if self._turn.ok else self._turn

    async def check(self) -> Check:
        """Try it, and return how it is within ANSWER_S."""
        now = time.monotonic()
        if self._probing is None and now - self._found_s > FRESH_S:
            self._begun_s = now
            self._probing = asyncio.create_task(self._probe(), name="readiness")
            self._probing.add_done_callback(self._note)
        if self._probing is not None:
            await asyncio.wait({self._probing}, timeout=ANSWER_S)
        return self.known

    def close(self) -> None:
        """End the probes."""
        for task in (self._probing, self._watching):
            if task is not None:
                task.cancel()

    async def _watch(self) -> None:
        while True:
            try:
                await self._store.wait_turn()
                self._turn = Check(ok=True, detail="")
            except RobomendError as error:
                self._turn = _failed(error)
            await asyncio.sleep(TURN_S)

    async def _probe(self) -> Check:
        try:
            await self._store.read(global_stop.get)
            await self._store.ownership.beat()
        except RobomendError as error:
            return _failed(error)
        return Check(ok=True, detail="")

    def _note(self, probing: asyncio.Task[Check]) -> None:
        self._probing = None
        if not probing.cancelled() and probing.exception() is None:
            self._found, self._found_s = probing.result(), time.monotonic()


def _failed(error: RobomendError) -> Check:
    return Check(ok=False, detail=f"{error.code}: {error}")
