"""Tells the service what the observers see: changes at once, everything as a heartbeat, nothing lost while it
is away.

Every literal goes out with a lifetime, so that what a dead agent said last becomes unknown instead of staying
true; the heartbeat says all of it again in time. While the service is away changes go to the disk (outbox.py)
and heartbeats are not worth keeping; when it is back the past is replayed in order, and a heartbeat with the
present follows at once.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections import deque
from collections.abc import Iterable

from robomend_client.clock import Clock
from robomend_client.literals import Atom, Literal
from robomend_client.outbox import AsyncOutbox
from robomend_client.rest.retry import Retry

log = logging.getLogger(__name__)

MOST_PENDING = 1000
"""Batches of changes in memory, while one is being sent."""


class Reporter:
    """One source of observations, towards the service."""

    def __init__(self, outbox: AsyncOutbox, source: str, heartbeat_s: float, lifetime_s: float) -> None:
        self._outbox = outbox
        self._source = source
        self._heartbeat_s = heartbeat_s
        self._lifetime_s = lifetime_s
        self._now: dict[Atom, Literal] = {}
        self._pending: deque[tuple[int, list[Literal]]] = deque()
        self._wake = asyncio.Event()
        self._away = False
        self._clock = Clock()
        self._refused = outbox.refused

    @property
    def holding(self) -> tuple[Literal, ...]:
        """What holds now, as far as the observers know."""
        return tuple(self._now.values())

    def update(self, asked: Iterable[Atom], literals: Iterable[Literal]) -> None:
        """Take what observers found: of the atoms `asked` about, `literals` hold and the rest is unknown."""
        found = {literal.atom: literal for literal in literals}
        changed = [literal for atom, literal in found.items() if self._now.get(atom) != literal]
        for atom in asked:
            if atom not in found:
                self._now.pop(atom, None)  # unknown is no literal; its lifetime runs out at the service
        self._now.update(found)
        if changed:
            if len(self._pending) >= MOST_PENDING:
                self._pending[-1][1].extend(changed)
            else:
                self._pending.append((self._clock.now_ns(), changed))
            self._wake.set()

    async def run(self) -> None:
        """Send changes as they come and heartbeats in between, for ever."""
        retry = Retry(longest_s=2.0)
        failures = 0
        due = 0.0
        while True:
            wait_s = retry.wait_s(failures, 0.5) if failures else max(0.0, due - time.monotonic())
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(wait_s):
                    await self._wake.wait()
            self._wake.clear()
            arrived = await self._send_pending()
            if arrived and (failures or time.monotonic() >= due):
                arrived = await self._heartbeat()
                due = time.monotonic() + self._heartbeat_s
            if self._outbox.refused != self._refused:
                self._refused = self._outbox.refused
                # Perhaps for stamps 60 s ahead of the service's clock: those were wrong all along.
                self._clock.follow()
            self._say(arrived)
            failures = 0 if arrived else failures + 1

    async def flush(self) -> None:
        """Send, or keep on the disk, what is pending: the agent is ending."""
        await self._send_pending()

    async def _send_pending(self) -> bool:
        arrived = await self._outbox.flush()
        while self._pending:
            time_ns, literals = self._pending.popleft()
            if arrived:
                arrived = await self._outbox.observe(
                    literals, time_ns=time_ns, source=self._source, lifetime_s=self._lifetime_s
                )
            else:  # straight to the disk: a service that hangs must not be waited for once per batch
                self._outbox.put(literals, time_ns=time_ns, source=self._source, lifetime_s=self._lifetime_s)
        return arrived

    async def _heartbeat(self) -> bool:
        if not self._now:
            return True
        return await self._outbox.observe(
            self.holding,
            time_ns=self._clock.now_ns(),
            source=self._source,
            lifetime_s=self._lifetime_s,
            buffered=False,
        )

    def _say(self, arrived: bool) -> None:
        if arrived and self._away:
            log.info("the service is back; what waited has been sent")
        elif not arrived and not self._away:
            log.warning(
                "the service takes no observations, they wait on the disk: %s", self._outbox.last_problem
            )
        self._away = not arrived
