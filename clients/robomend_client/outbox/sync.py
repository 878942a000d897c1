"""The outbox for threads. One at a time may use it: the order is the point."""

# Made from robomend_client/outbox/asynchronous.py by make_sync.py: change that one.

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from robomend_client.buffer import DiskBuffer
from robomend_client.literals import Literal
from robomend_client.outbox.backlog import LATER, Backlog, Refused
from robomend_client.rest.errors import ApiError
from robomend_client.rest.retry import NEVER
from robomend_client.rest.sync import Client


class Outbox(Backlog):
    """Observations of one robot, at once or from the disk; see the package."""

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

        `evidence` is what `calls.observe` takes beside them: since, onset, readings, unknown, settled. What
        is soon said again (a heartbeat) need not wait on the disk: `buffered=False`.
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
