"""The outermost layer: what is done for every request before a route is known, and after its answer.

    a batch that would wait too long ──► 503 (robomend.api.shedding)
    request id ──► Origin ──► the application ──► log line, metrics

A page of another site can make a browser send requests here, so a request that changes something must not
come from another origin. Bearer keys are not sent by browsers on their own; without keys, see also the gate.
"""

from __future__ import annotations

import re
import secrets
import time
from collections.abc import Iterable
from itertools import count

import structlog
from starlette.requests import ClientDisconnect
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from robomend.api.conditional import Conditional, head_as_get
from robomend.api.express import PATH, RULE, Express
from robomend.api.loop_watch import timed
from robomend.api.origin import by_name, foreign
from robomend.api.problems import Problem, unforeseen
from robomend.api.rates import Bucket
from robomend.api.shedding import LoadShedding
from robomend.logs import PRINCIPAL, REQUEST, debugging
from robomend.metrics import Metrics
from robomend.room import out_of_memory
from robomend.security import API

log = structlog.get_logger("robomend.http")

REQUEST_ID = re.compile(rb"[A-Za-z0-9._\-]{1,64}\Z")
SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
Header = tuple[bytes, bytes]
# An answer's own headers go before these: a form of a page without referrer comes with `Origin: null`.
SECURITY_HEADERS = ((b"x-content-type-options", b"nosniff"), (b"referrer-policy", b"no-referrer"))


class Edge:
    """ASGI middleware; see the module."""

    def __init__(
        self, app: ASGIApp, *, metrics: Metrics, express: Express | None, shedding: LoadShedding | None
    ) -> None:
        self._app = app
        self._express = express
        self._shedding = shedding
        self._metrics = metrics
        self._run = secrets.token_hex(4)  # told apart over restarts and instances
        self._count = count(1)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began = scope["robomend.began"] = time.perf_counter()
        request_id = self._name(scope)
        if scope["method"] == "POST" and PATH.match(scope["path"]):
            late = self._shed()
            if late is not None:
                await late.response(request_id)(scope, receive, send)
                return
        status = 0

        async def with_headers(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                message["headers"] = with_ours(message.get("headers", ()), scope)
            await send(message)

        REQUEST.set(request_id)
        answer: Send = with_headers
        asked, scope = scope, head_as_get(scope)
        if scope["method"] == "GET" and scope["path"].startswith(API):
            answer = Conditional(by_name(scope).get(b"if-none-match"), answer)
        try:
            problem = refusal(scope)
            if problem is not None:
                await problem.response(request_id)(scope, receive, answer)
            elif self._express is not None and self._express.takes(scope):
                await timed(self._express(scope, receive, answer), self._metrics.held)
            else:
                await timed(_coroutine(self._app, scope, receive, answer), self._metrics.held)
        except ClientDisconnect:
            status = status or 499  # nobody is left to answer; the log line and the metrics say so
        except Exception as error:  # noqa: BLE001  # a bug of ours: it is logged and has an answer
            response = _failed(scope, error, answered=status != 0)
            if status == 0:
                await response(scope, receive, answer)
        finally:
            self._note(scope, asked["method"], status, time.perf_counter() - began)
            REQUEST.set(None)
            PRINCIPAL.set(None)

    def begin(self, scope: Scope) -> Response | None:
        """Take up a plain batch, for robomend.api.direct; return why it is refused, or None."""
        scope["robomend.began"] = time.perf_counter()
        request_id = self._name(scope)
        late = self._shed()
        return None if late is None else late.response(request_id)

    async def direct(self, scope: Scope, body: bytes) -> Response:
        """Return the answer to a plain batch that has begun, without the headers that every answer has.

        The same as above: a request with no Origin, in a context of its own.
        """
        assert self._express is not None
        REQUEST.set(scope["robomend.request_id"])
        try:
            response = await self._express.answer(scope, body)
        except Exception as error:  # noqa: BLE001  # as above
            response = _failed(scope, error, answered=False)
        status, elapsed_s = response.status_code, time.perf_counter() - scope["robomend.began"]
        self._metrics.request(*RULE, status, elapsed_s)
        if status >= 400 or debugging():
            _tell(scope, "POST", status, elapsed_s)
        return response

    def _name(self, scope: Scope) -> str:
        """Give the request its id: the one that it brings, or one of ours."""
        given = by_name(scope).get(b"x-request-id")
        if given is not None and REQUEST_ID.match(given):
            name = given.decode()
        else:
            name = f"{self._run}-{next(self._count):x}"
        scope["robomend.request_id"] = name
        return name

    def _shed(self) -> Problem | None:
        """Return why a batch that comes now is refused, or None."""
        late = None if self._shedding is None else self._shedding.refusal()
        if late is not None:
            self._metrics.request("POST", RULE[1], late.status, None)
        return late

    def _note(self, scope: Scope, method: str, status: int, elapsed_s: float) -> None:
        route = getattr(scope.get("route"), "path_format", "none")
        waited = scope.get("robomend.waits")
        self._metrics.request(method, route, status, None if waited else elapsed_s)
        if status >= 400 or debugging():
            _tell(scope, method, status, elapsed_s)


def _tell(scope: Scope, method: str, status: int, elapsed_s: float) -> None:
    level = log.info if status >= 400 else log.debug
    level(
        "request",
        method=method,
        path=scope["path"],
        status=status,
        ms=round(elapsed_s * 1000, 2),
        principal=scope.get("robomend.principal_name"),
    )


def with_ours(own: Iterable[Header], scope: Scope) -> list[Header]:
    """Return an answer's headers with those that every answer has."""
    headers = list(own)
    names = {name.lower() for name, _ in headers}
    headers.append((b"x-request-id", scope["robomend.request_id"].encode()))
    headers += [header for header in SECURITY_HEADERS if header[0] not in names]
    bucket: Bucket | None = scope.get("robomend.rate")
    if bucket is not None:
        headers += bucket.headers()
    return headers


def _failed(scope: Scope, error: Exception, *, answered: bool) -> Response:
    """Return the answer to what nobody caught; the log tells more."""
    if out_of_memory(error) and not answered:
        log.error("out of memory", method=scope["method"], path=scope["path"], detail=str(error))
        why = "this process may have no more memory (`ulimit -v`, a cgroup); try again later"
        return Problem(503, why, code="overloaded").response(scope["robomend.request_id"])
    # A bug of ours: the client gets its 500, the log the traceback.
    log.error("unforeseen", method=scope["method"], path=scope["path"], exc_info=error)
    return unforeseen(scope["robomend.request_id"])


async def _coroutine(app: ASGIApp, scope: Scope, receive: Receive, send: Send) -> None:
    await app(scope, receive, send)


def refusal(scope: Scope) -> Problem | None:
    """Return why this request is not even looked at, or None."""
    if scope["method"] in SAFE or (header := foreign(scope)) is None:
        return None
    return Problem(
        403, f"a change may not come from a page of another origin ({header})", code="cross-origin"
    )
