"""The outbox for asyncio. One at a time may use it: the order is the point."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from robomend_client.buffer import DiskBuffer
from robomend_client.literals import Literal
from robomend_client.outbox.backlog import LATER, Backlog, Refused
from robomend_client.rest.asynchronous import AsyncClient
from robomend_client.rest.errors import ApiError
from robomend_client.rest.retry import NEVER


class AsyncOutbox(Backlog):
    """Observations of one robot, at once or from the disk; see the package."""

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

        `evidence` is what `calls.observe` takes beside them: since, onset, readings, unknown, settled. What
        is soon said again (a heartbeat) need not wait on the disk: `buffered=False`.
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
