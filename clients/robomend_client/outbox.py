"""Observations on their way to a service that may be away:
at once when it is there, from the disk when it is back.

Everything arrives in the order in which it was seen: while something waits in the buffer, new observations
wait behind it. Each batch carries its time and an Idempotency-Key, kept in the buffer too, so that a lost
answer or a crash never makes it count twice. What the service refuses for good (4xx) is dropped, counted and
told in the log: a bad sentence must not hold up all later ones.

    buffer = DiskBuffer("/var/lib/robot/observations")
    outbox = Outbox(client, "tedusar", buffer)
    await outbox.observe(["not ok(scan)"])          # never raises for a service that is away
    await outbox.flush()                            # now and then
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable, Mapping
from typing import Any

from robomend_client.buffer import DiskBuffer
from robomend_client.literals import Literal
from robomend_client.rest import calls
from robomend_client.rest.asynchronous import AsyncClient
from robomend_client.rest.errors import (
    ApiError,
    Forbidden,
    NotFound,
    NotTheService,
    ServiceFailed,
    TooManyRequests,
    Unauthorized,
    Unreachable,
)
from robomend_client.rest.retry import NEVER
from robomend_client.rest.types import Accepted

log = logging.getLogger(__name__)

LATER = (Unreachable, NotTheService, ServiceFailed, TooManyRequests, Unauthorized, Forbidden, NotFound)
"""Why a batch waits. A wrong key or a robot that is not there yet counts: the operator mends that."""


class Outbox:
    """Observations of one robot. One at a time may use it: the order is the point."""

    def __init__(self, client: AsyncClient, robot: str, buffer: DiskBuffer) -> None:
        self.buffer = buffer
        self.refused = 0  # batches, whole
        self.lost = 0  # could not even be buffered
        self.last_problem: Exception | None = None  # why the newest attempt failed; None when it did not
        self._client = client
        self._robot = robot
        self._refusing = ""  # why the newest batch was refused; nothing: it was not
        self._told: set[str] = set()

    async def observe(
        self,
        observations: Iterable[str | Literal],
        *,
        time_ns: int | None = None,
        source: str | None = None,
        lifetime_s: float | None = None,
        evidence: Mapping[str, Any] | None = None,
        buffered: bool = True,
    ) -> bool:
        """Report observations; True if the service has them, False if they wait on the disk.

        `evidence` is what `calls.observe` takes beside them: since, onset, readings, unknown, settled. What
        is soon said again (a heartbeat) need not wait on the disk: `buffered=False`.
        """
        batch = _batch(observations, time_ns, source, lifetime_s, evidence)
        if await self.flush() and await self._send(batch):
            return True
        if buffered:
            self._keep(batch)
        return False

    def put(
        self,
        observations: Iterable[str | Literal],
        *,
        time_ns: int | None = None,
        source: str | None = None,
        lifetime_s: float | None = None,
        evidence: Mapping[str, Any] | None = None,
    ) -> None:
        """Put observations at the end of what waits, without trying the service."""
        self._keep(_batch(observations, time_ns, source, lifetime_s, evidence))

    async def flush(self) -> bool:
        """Send what waits, oldest first; True if nothing is left."""
        while (batch := self.buffer.peek()) is not None:
            if not await self._send(batch):
                return False
            self.buffer.take()
        return True

    async def _send(self, batch: dict[str, Any]) -> bool:
        # The good sentences of a batch count, even if a name in it is one that the model does not declare.
        call = calls.observe(self._robot, together=False, **batch)
        try:
            self._look_at(await self._client.send(call, NEVER))
        except LATER as error:
            self.last_problem = error
            return False
        except ApiError as error:
            self._refuse(batch, error)
        self.last_problem = None
        return True

    def _keep(self, batch: dict[str, Any]) -> None:
        """Put a batch at the end of what waits."""
        try:
            self.buffer.append(batch)
        except OSError as error:  # a full disk must not stop the robot's agent
            self.lost += 1
            log.error("cannot buffer %s: %s", batch["observations"], error)

    def _look_at(self, accepted: Accepted) -> None:
        """Tell of sentences that the service did not keep, each once: a heartbeat says them for ever."""
        self._refusing = ""
        for refused in accepted.get("refused", ()):
            if refused["sentence"] not in self._told and len(self._told) < 1000:
                self._told.add(refused["sentence"])
                log.error("the service did not keep %r: %s", refused["sentence"], refused["message"])

    def _refuse(self, batch: dict[str, Any], error: ApiError) -> None:
        """Count a batch that the service will never take; of those in a row, the first is told."""
        self.refused += 1
        level = logging.DEBUG if error.code == self._refusing else logging.ERROR
        self._refusing = error.code
        log.log(level, "the service refused %s: %s", batch["observations"], error)


def _batch(
    observations: Iterable[str | Literal],
    time_ns: int | None,
    source: str | None,
    lifetime_s: float | None,
    evidence: Mapping[str, Any] | None,
) -> dict[str, Any]:
    """Return observations as they wait: with their time and a key of their own."""
    return {
        "observations": [str(sentence) for sentence in observations],
        "time_ns": time.time_ns() if time_ns is None else time_ns,
        "source": source,
        "lifetime_s": lifetime_s,
        "key": calls.new_key(),
        **(evidence or {}),
    }
