"""What waits for the service, what it refused, and what could not be kept."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from robomend_client.buffer import DiskBuffer
from robomend_client.literals import Literal
from robomend_client.rest import calls
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
from robomend_client.rest.types import Accepted

log = logging.getLogger(__name__)

Refused = Callable[[dict[str, Any], ApiError], None]

LATER = (Unreachable, NotTheService, ServiceFailed, TooManyRequests, Unauthorized, Forbidden, NotFound)
"""Why a batch waits. A wrong key or a robot that is not there yet counts: the operator mends that."""


class Backlog:
    """What both outboxes share."""

    def __init__(self, robot: str, buffer: DiskBuffer, on_refused: Refused | None) -> None:
        self.robot = robot
        self.buffer = buffer
        self.refused = 0  # batches, whole
        self._refusing = ""  # why the newest batch was refused; nothing: it was not
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
        """Return observations as they wait: with their time and a key of their own."""
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
        """Return the call that reports a batch."""
        # The good sentences of a batch count, even if a name in it is one that the model does not declare.
        return calls.observe(self.robot, together=False, **batch)

    def keep(self, batch: dict[str, Any]) -> None:
        """Put a batch at the end of what waits."""
        try:
            self.buffer.append(batch)
        except OSError as error:  # a full disk must not stop the robot's agent
            self.lost += 1
            log.error("cannot buffer %s: %s", batch["observations"], error)

    def look_at(self, accepted: Accepted) -> None:
        """Tell of sentences that the service did not keep, each once: a heartbeat says them for ever."""
        self._refusing = ""
        for refused in accepted.get("refused", ()):
            if refused["sentence"] not in self._told and len(self._told) < 1000:
                self._told.add(refused["sentence"])
                log.error("the service did not keep %r: %s", refused["sentence"], refused["message"])

    def refuse(self, batch: dict[str, Any], error: ApiError) -> None:
        """Count a batch that the service will never take; of those in a row, the first is told."""
        self.refused += 1
        level = logging.DEBUG if error.code == self._refusing else logging.ERROR
        self._refusing = error.code
        log.log(level, "the service refused %s: %s", batch["observations"], error)
        if self._on_refused is not None:
            self._on_refused(batch, error)
