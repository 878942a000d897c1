"""A plain batch of observations from the connection to the answer, with nothing in between.

    head: POST …/observations, JSON, so long ──► the whole body came ── yes ──► Direct ──► one write
                   │ anything else                      │ not within a moment
                   └────────────────────────────────────┴─► an ASGI request, as all others are

A server's request is an object with two queues, an event and a dictionary for each message; for this one
request, which comes a thousand times a second, they cost more than what it asks for. What it asks for is done
by the same functions (edge.py, express.py): both ways give the same answers. protocol.py decides which way.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from http import HTTPStatus

from starlette.responses import Response
from starlette.types import Scope

from robomend.api.edge import Edge
from robomend.api.express import Express
from robomend.api.strict_json import AT_ONCE

Headers = list[tuple[bytes, bytes]]

LENGTH = re.compile(rb"[0-9]{1,6}\Z")

MOMENT_S = 0.05
"""For a body that comes behind its head; then it is watched like any other."""

ONLY = frozenset(
    {
        b"accept",
        b"accept-encoding",
        b"authorization",
        b"connection",
        b"content-length",
        b"content-type",
        b"host",
        b"idempotency-key",
        b"user-agent",
        b"x-request-id",
    }
)
"""Of a plain request; any other header may mean something."""

_STATUS_LINES = {
    status.value: b"HTTP/1.1 %d %s\r\n" % (status.value, status.phrase.encode()) for status in HTTPStatus
}


@dataclass(slots=True)
class Exchange:
    """A request and its answer, as the connection looks at them: uvicorn's cycle of other requests."""

    keep_alive: bool
    disconnected: bool = False
    response_started: bool = False
    response_complete: bool = False
    more_body: bool = False

    @property
    def message_event(self) -> Exchange:
        """What a connection that is lost sets; nobody waits for it here."""
        return self

    def set(self) -> None:
        """Nobody waits."""


class Direct:
    """Answers plain batches; see the module. Belongs to the service's event loop."""

    def __init__(self, edge: Edge, express: Express, max_body_bytes: int) -> None:
        self._edge = edge
        self._express = express
        self._most = min(max_body_bytes, AT_ONCE)

    def takes(self, scope: Scope) -> bool:
        """Return whether a request with this head is a plain one; then `scope` knows its robot."""
        headers = dict(scope["headers"])
        length = headers.get(b"content-length", b"")
        return (
            len(headers) == len(scope["headers"])
            and headers.keys() <= ONLY
            and LENGTH.match(length) is not None
            and 0 < int(length) <= self._most
            and self._express.takes(scope, headers)
        )

    async def answer(self, scope: Scope, body: bytes, exchange: Exchange, usual: Headers) -> bytes:
        """Return the whole answer to a plain batch, as it goes over the wire; `usual` are headers of all."""
        response, headers = await self._edge.direct(scope, body)
        if not exchange.keep_alive:
            headers = [*headers, (b"connection", b"close")]
        return _wire(response, [*usual, *headers])


def _wire(response: Response, headers: Headers) -> bytes:
    lines = [_STATUS_LINES[response.status_code]]
    for name, value in headers:
        lines += (name, b": ", value, b"\r\n")
    lines += (b"\r\n", bytes(response.body))
    return b"".join(lines)
