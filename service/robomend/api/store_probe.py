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

from robomend.api.schemas.operation import Check
from robomend.errors import RobomendError, StoreDamaged, StoreFull
from robomend.store import Store, global_stop

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
