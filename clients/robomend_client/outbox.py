"""Observations on their way to a service that may be away:
at once when it is there, from the disk when it is back.

Everything arrives in the order in which it was seen: while something waits in the buffer, new observations
wait behind it. Each batch carries its time and an Idempotency-Key, kept in the buffer too, so that a lost
answer or a crash never makes it count twice. What the service refuses for good (4xx) is dropped, counted and
told to `on_refused`: a bad sentence must not hold up all later ones.

    buffer = DiskBuffer("/var/lib/robot/observations")
    outbox = Outbox(client, "tedusar", buffer)
    outbox.observe(["not ok(scan)"])          # never raises for a service that is away
    outbox.flush()                            # now and then
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from robomend_client.buffer import DiskBuffer
from robomend_client.literals import Literal
from robomend_client.rest import calls
from robomend_client.rest.asynchronous import AsyncClient
from robomend_client.rest.calls import Call
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
from robomend_client.rest.sync import Client
from robomend_client.rest.types import Accepted

log = logging.getLogger(__name__)

Refused = Callable[[dict[str, Any], ApiError], None]

LATER = (Unreachable, NotTheService, ServiceFailed, TooManyRequests, Unauthorized, Forbidden, NotFound)
"""Why a batch waits. A wrong key or a robot that is not there yet counts: the operator mends that."""


class _Queue:
    """What both outboxes share: the batches that wait."""

    def __init__(self, robot: str, buffer: DiskBuffer, on_refused: Refused | None) -> None:
        self.robot = robot
        self.buffer = buffer
        self.refused = 0
        self.lost = 0  # could not even be buffered
        self.last_problem: Exception | None = None  # why the newest attempt failed; None when it did not
        self._on_refused = on_refused
        self._told: set[str] = set()

    def batch(
        self,
        observations: Iterable[str | Literal],
        time_ns: int | None,
        source: str | None,
        lifetime_s: float | None,
        evidence: Mapping[str, Any] | None = None,
    ) -> dict[str, Any]:
        return {
            "observations": [str(sentence) for sentence in observations],
            "time_ns": time.time_ns() if time_ns is None else time_ns,
            "source": source,
            "lifetime_s": lifetime_s,
            "key": calls.new_key(),
            **(evidence or {}),
        }

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
        self.keep(self.batch(observations, time_ns, source, lifetime_s, evidence))

    def call(self, batch: dict[str, Any]) -> Call[Accepted]:
        # The good sentences of a batch count, even if a name in it is one that the model does not declare.
        return calls.observe(self.robot, together=False, **batch)

    def keep(self, batch: dict[str, Any]) -> None:
        try:
            self.buffer.append(batch)
        except OSError as error:  # a full disk must not stop the robot's agent
            self.lost += 1
            log.error("cannot buffer %s: %s", batch["observations"], error)

    def look_at(self, accepted: Accepted) -> None:
        """Tell of sentences that the service did not keep, each once: a heartbeat says them for ever."""
        for refused in accepted.get("refused", ()):
            self.refused += 1
            if refused["sentence"] not in self._told and len(self._told) < 1000:
                self._told.add(refused["sentence"])
                log.error("the service did not keep %r: %s", refused["sentence"], refused["message"])

    def refuse(self, batch: dict[str, Any], error: ApiError) -> None:
        self.refused += 1
        log.error("the service refused %s: %s", batch["observations"], error)
        if self._on_refused is not None:
            self._on_refused(batch, error)


class Outbox(_Queue):
    """For threads and scripts."""

    def __init__(
        self, client: Client, robot: str, buffer: DiskBuffer, on_refused: Refused | None = None
    ) -> None:
        super().__init__(robot, buffer, on_refused)
        self._client = client

    def observe(
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

        `evidence` is what `calls.observe` takes beside them: since, onset, unknown, settled. What is soon
        said again (a heartbeat) need not wait on the disk: `buffered=False`.
        """
        batch = self.batch(observations, time_ns, source, lifetime_s, evidence)
        if not self.flush():
            if buffered:
                self.keep(batch)
            return False
        if not self._send(batch):
            if buffered:
                self.keep(batch)
            return False
        return True

    def flush(self) -> bool:
        """Send what waits, oldest first; True if nothing is left."""
        while (batch := self.buffer.peek()) is not None:
            if not self._send(batch):
                return False
            self.buffer.take()
        return True

    def _send(self, batch: dict[str, Any]) -> bool:
        try:
            self.look_at(self._client.send(self.call(batch), NEVER))
        except LATER as error:
            self.last_problem = error
            return False
        except ApiError as error:
            self.refuse(batch, error)
        self.last_problem = None
        return True


class AsyncOutbox(_Queue):
    """For asyncio. One task at a time may use it: the order is the point."""

    def __init__(
        self, client: AsyncClient, robot: str, buffer: DiskBuffer, on_refused: Refused | None = None
    ) -> None:
        super().__init__(robot, buffer, on_refused)
        self._client = client

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

        `evidence` is what `calls.observe` takes beside them: since, onset, unknown, settled. What is soon
        said again (a heartbeat) need not wait on the disk: `buffered=False`.
        """
        batch = self.batch(observations, time_ns, source, lifetime_s, evidence)
        if not await self.flush():
            if buffered:
                self.keep(batch)
            return False
        if not await self._send(batch):
            if buffered:
                self.keep(batch)
            return False
        return True

    async def flush(self) -> bool:
        """Send what waits, oldest first; True if nothing is left."""
        while (batch := self.buffer.peek()) is not None:
            if not await self._send(batch):
                return False
            self.buffer.take()
        return True

    async def _send(self, batch: dict[str, Any]) -> bool:
        try:
            self.look_at(await self._client.send(self.call(batch), NEVER))
        except LATER as error:
            self.last_problem = error
            return False
        except ApiError as error:
            self.refuse(batch, error)
        self.last_problem = None
        return True
