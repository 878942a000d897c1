"""Tells the service what the observers see: changes at once, everything as a heartbeat, nothing lost while it
is away.

Every literal goes out with its evidence and a lifetime, so that what a dead agent said last becomes unknown
instead of staying true; the heartbeat says all of it again in time, with the present evidence. While the
service is away changes go to the disk (outbox.py) and heartbeats are not worth keeping; when it is back the
past is replayed in order, and a heartbeat with the present follows at once.

What the service wanted to be judged anew, and is bad still, is said more often for a while: a repair waits
for it, as it cannot know otherwise that nothing has changed since.

docs/agent.md, "What it tells the service", has the batches as they are on the wire.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from robomend_client.clock import Clock
from robomend_client.literals import Atom, Literal
from robomend_client.observers import Change, Verdict
from robomend_client.outbox import Outbox
from robomend_client.python310 import timeout
from robomend_client.readings import Reading
from robomend_client.rest.retry import Retry

log = logging.getLogger(__name__)

MOST_PENDING = 1000
"""Batches of changes in memory, while one is being sent; beyond it the oldest go, and the heartbeat tells."""

CLOSELY_S = 0.2
"""How often what was judged anew for the service is said again, as long as it is bad …"""

FOLLOWED_S = 10.0
"""… and for how long: by then a repair waits for something else."""


class VerdictReporter:
    """One source of observations, towards the service."""

    def __init__(
        self,
        outbox: Outbox,
        source: str,
        heartbeat_s: float,
        lifetime_s: float,
        standing: Callable[[], Sequence[Verdict]],
        clock: Clock | None = None,
    ) -> None:
        """`standing` returns what holds now, for the heartbeat."""
        self._outbox = outbox
        self._source = source
        self._heartbeat_s = heartbeat_s
        self._lifetime_s = lifetime_s
        self._standing = standing
        self._pending: deque[list[Change]] = deque(maxlen=MOST_PENDING)
        self._followed: dict[Atom, float] = {}  # what was judged anew, and is bad -> until when
        self._due_s = 0.0  # when the next heartbeat is, by time.monotonic()
        self._wake = asyncio.Event()
        self._away = False
        self._clock = clock or Clock()
        self._refused = outbox.refused

    def report(self, changes: Iterable[Change]) -> None:
        """Take what changed, in order."""
        for change in changes:
            last = self._pending[-1][-1] if self._pending else None
            if last is not None and (last.time_ns, last.settled) == (change.time_ns, change.settled):
                self._pending[-1].append(change)
            else:
                self._pending.append([change])
            if change.value is None or change.value.positive:
                self._followed.pop(change.atom, None)
            elif change.settled is not None:
                self._followed[change.atom] = time.monotonic() + FOLLOWED_S
        if self._pending:
            self._wake.set()

    async def run(self) -> None:
        """Send changes as they come and heartbeats in between, for ever."""
        retry = Retry(longest_s=2.0)
        failures = 0
        again = 0.0
        while True:
            next_s = min(self._due_s, again) if self._followed else self._due_s
            wait_s = retry.wait_s(failures, 0.5) if failures else max(0.0, next_s - time.monotonic())
            with contextlib.suppress(TimeoutError):
                async with timeout(wait_s):
                    await self._wake.wait()
            self._wake.clear()
            arrived = await self._send_pending()
            if arrived and (failures or time.monotonic() >= self._due_s):
                arrived = await self._heartbeat()
                self._due_s = time.monotonic() + self._heartbeat_s
            elif arrived and self._followed and time.monotonic() >= again:
                arrived = await self._say_again(self._still_bad())
                again = time.monotonic() + CLOSELY_S
            if self._outbox.refused != self._refused:
                self._refused = self._outbox.refused
                # Perhaps for stamps 60 s ahead of the service's clock: those were wrong all along.
                self._clock.follow()
            self._say(arrived)
            failures = 0 if arrived else failures + 1

    @property
    def quiet(self) -> bool:
        """Whether the service has all that was reported."""
        return not self._away and not self._pending and not len(self._outbox.buffer)

    async def flush(self) -> None:
        """Send, or keep on the disk, what is pending: the agent is ending."""
        await self._send_pending()
        while self._pending:
            await self._send_pending()

    async def _send_pending(self) -> bool:
        arrived = await self._outbox.flush()
        while self._pending:
            changes = self._pending.popleft()
            # Changes that come faster than they are taken must not keep heartbeats from being sent for ever.
            overdue = 0 < self._due_s < time.monotonic()
            if overdue:
                while self._pending and self._pending[0][0].settled == changes[0].settled:
                    changes += self._pending.popleft()
            # Of an atom that changed twice, the last counts.
            newest = tuple({change.atom: change for change in changes}.values())
            said = [change for change in newest if change.value is not None]
            literals = [change.value for change in said if change.value is not None]
            batch: dict[str, Any] = {
                "time_ns": max(change.time_ns for change in changes),
                "source": self._source,
                "lifetime_s": self._lifetime_s,
                "evidence": evidence(
                    [(change.since_ns, change.onset_ns, change.reading) for change in said],
                    unknown=[str(change.atom) for change in newest if change.value is None],
                    settled=changes[0].settled,
                ),
            }
            if arrived:
                arrived = await self._outbox.observe(literals, **batch)
            else:  # straight to the disk: a service that hangs must not be waited for once per batch
                self._outbox.put(literals, **batch)
            if overdue:
                break
        return arrived

    def _still_bad(self) -> list[Verdict]:
        """Return what stands of what is followed."""
        now = time.monotonic()
        self._followed = {atom: until for atom, until in self._followed.items() if until > now}
        return [verdict for verdict in self._standing() if verdict.literal.atom in self._followed]

    async def _heartbeat(self) -> bool:
        return await self._say_again(self._standing())

    async def _say_again(self, verdicts: Sequence[Verdict]) -> bool:
        if self._pending and not await self._send_pending():  # asking may have shown changes: in their order
            return False
        if not verdicts:
            return True
        literals: list[Literal] = [verdict.literal for verdict in verdicts]
        return await self._outbox.observe(
            literals,
            time_ns=self._clock.now_ns(),
            source=self._source,
            lifetime_s=self._lifetime_s,
            evidence=evidence(
                [(verdict.since_ns, verdict.onset_ns, verdict.reading) for verdict in verdicts]
            ),
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


def evidence(
    rests_on: Sequence[tuple[int | None, int | None, Reading | None]],
    unknown: Sequence[str] = (),
    settled: int | None = None,
) -> dict[str, Any]:
    """Return what a batch says beside its observations; `rests_on`: since, onset and reading of each."""
    found: dict[str, Any] = {}
    if rests_on:
        found["since"] = [since_ns for since_ns, _, _ in rests_on]
    if any(onset_ns is not None for _, onset_ns, _ in rests_on):
        found["onset"] = [onset_ns for _, onset_ns, _ in rests_on]
    if any(reading is not None for _, _, reading in rests_on):
        found["readings"] = [None if reading is None else reading.as_json() for _, _, reading in rests_on]
    if unknown:
        found["unknown"] = list(unknown)
    if settled is not None:
        found["settled"] = settled
    return found
