"""Tries whether the store reads and writes, when somebody asks; an answer never waits for it.

What takes long goes on, and the answer says what is known of it by then. A probe that has hung for HANGS_S
says that the database hangs.
"""

from __future__ import annotations

import asyncio
import time

from robomend.api.schemas.operation import Check
from robomend.errors import RobomendError
from robomend.store import Store, global_stop

ANSWER_S = 0.03
"""For the probe; an answer does not wait longer."""

HANGS_S = 2.0
"""A probe without an answer for so long hangs."""

FRESH_S = 1.0
"""A probe's answer counts so long, so that a hundred who ask write once."""


class StoreProbe:
    """See the module. Belongs to the store's event loop."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._probing: asyncio.Task[Check] | None = None
        self._begun_s = 0.0
        self._found = Check(ok=True, detail="")
        self._found_s = float("-inf")

    async def check(self) -> Check:
        """Return how the store is, within ANSWER_S."""
        now = time.monotonic()
        if self._probing is None and now - self._found_s > FRESH_S:
            self._begun_s = now
            self._probing = asyncio.create_task(self._probe(), name="readiness")
            self._probing.add_done_callback(self._note)
        if self._probing is not None:
            await asyncio.wait({self._probing}, timeout=ANSWER_S)
        if self._probing is not None and (hung_s := time.monotonic() - self._begun_s) > HANGS_S:
            return Check(ok=False, detail=f"no answer to a read and a write in {hung_s:.0f} s")
        return self._found

    def close(self) -> None:
        """End the probe."""
        if self._probing is not None:
            self._probing.cancel()

    async def _probe(self) -> Check:
        try:
            await self._store.read(global_stop.get)
            await self._store.ownership.beat()
        except RobomendError as error:
            return Check(ok=False, detail=f"{error.code}: {error}")
        return Check(ok=True, detail="")

    def _note(self, probing: asyncio.Task[Check]) -> None:
        self._probing = None
        if not probing.cancelled() and probing.exception() is None:
            self._found, self._found_s = probing.result(), time.monotonic()
