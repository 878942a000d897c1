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
from collections.abc import Coroutine, Iterable
from http import HTTPStatus
from typing import Any

from starlette.responses import Response
from starlette.types import Scope

from robomend.api.edge import SECURITY_HEADERS, Edge, Header, with_ours
from robomend.api.express import Express
from robomend.api.origin import by_name
from robomend.api.rates import Bucket
from robomend.api.strict_json import AT_ONCE
from robomend.api.views import AcceptedResponse
from robomend.metrics import Metrics

Headers = list[Header]

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


class Exchange:
    """A request and its answer, as the connection looks at them: uvicorn's cycle of other requests."""

    __slots__ = ("disconnected", "keep_alive", "response_complete")

    more_body = False
    response_started = False
    """Also of one that is complete, as whoever asks for it asks for `more_body` as well."""

    def __init__(self, keep_alive: bool) -> None:
        self.keep_alive = keep_alive
        self.disconnected = False
        self.response_complete = False

    @property
    def message_event(self) -> Exchange:
        """What a connection that is lost sets; nobody waits for it here."""
        return self

    def set(self) -> None:
        """Nobody waits."""


class Direct:
    """Answers plain batches; see the module. Belongs to the service's event loop."""

    def __init__(self, edge: Edge, express: Express, metrics: Metrics, max_body_bytes: int) -> None:
        self._edge = edge
        self._express = express
        self.most_bytes = min(max_body_bytes, AT_ONCE)
        """Of the body of a plain batch."""
        self.held = metrics.held
        """Takes the longest that an answer held the event loop."""
        self._usual: Headers = []
        self._beginning = b""  # of an answer, up to the first header of its own

    def takes(self, scope: Scope) -> bool:
        """Return whether a request with this head is a plain one; then `scope` knows its robot."""
        headers = by_name(scope)
        length = headers.get(b"content-length", b"")
        return (
            len(headers) == len(scope["headers"])
            and headers.keys() <= ONLY
            and LENGTH.match(length) is not None
            and 0 < int(length) <= self.most_bytes
            and self._express.takes(scope)
        )

    def refused(self, scope: Scope) -> Response | None:
        """Take up a plain batch: return why it is refused at once, or None; then `answer` answers it."""
        return self._edge.begin(scope)

    def refusal(self, late: Response, exchange: Exchange, usual: Headers) -> bytes:
        """Return a refusal as it goes over the wire."""
        return _wire(late, [*usual, *late.raw_headers], exchange)

    def answer(self, scope: Scope, body: bytes) -> Coroutine[Any, Any, Response]:
        """Return the answer to a plain batch that was taken up; `text` is how it goes over the wire."""
        return self._edge.direct(scope, body)

    def text(self, response: Response, scope: Scope, exchange: Exchange, usual: Headers) -> bytes:
        """Return a whole answer as it goes over the wire; `usual` are headers of all."""
        if not isinstance(response, AcceptedResponse) or not exchange.keep_alive:
            return _wire(response, [*usual, *with_ours(response.raw_headers, scope)], exchange)
        # The answer that nearly all have: the same text, with what is always the same made once.
        if self._usual is not usual:
            self._usual = usual
            self._beginning = b"HTTP/1.1 200 OK\r\n" + _lines(usual)
        bucket: Bucket | None = scope.get("robomend.rate")
        return b"%b%bx-request-id: %b\r\n%b%b\r\n%b" % (
            self._beginning,
            response.lines(),
            scope["robomend.request_id"].encode(),
            SECURITY,
            b"" if bucket is None else bucket.lines(),
            bytes(response.body),
        )


def _wire(response: Response, headers: Headers, exchange: Exchange) -> bytes:
    closing = b"" if exchange.keep_alive else b"connection: close\r\n"
    status = HTTPStatus(response.status_code)
    return b"HTTP/1.1 %d %b\r\n%b%b\r\n%b" % (
        *(status.value, status.phrase.encode()),
        *(_lines(headers), closing, bytes(response.body)),
    )


def _lines(headers: Iterable[Header]) -> bytes:
    return b"".join([b"%b: %b\r\n" % header for header in headers])


SECURITY = _lines(SECURITY_HEADERS)
