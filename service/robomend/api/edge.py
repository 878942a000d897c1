"""The outermost layer: what is done for every request before a route is known, and after its answer.

    a batch that would wait too long ──► 503 (robomend.api.shedding)
    request id ──► framing, Origin ──► the application ──► log line, metrics

A client that still sends when its connection is to end gets its answer, and is listened to for a moment
before the end: a reset would take the answer away from it (RFC 9112, 9.6).

A page of another site can make a browser send requests here, so a request that changes something must not
come from another origin. Bearer keys are not sent by browsers on their own; without keys, see also the gate.

Of answers that a client has already (ETag and 304 for what is read, RFC 9110, 13.1.2; and HEAD): each
answer to a GET in JSON or NDJSON is named by what is in it. A client that polls sends the name back as
If-None-Match and gets a 304 without a body while nothing has changed. What it saves is the way, not the
work. A resource that can be replaced names its versions itself, for If-Match.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import re
import secrets
import time
from collections.abc import Iterable
from itertools import count

import structlog
from starlette.requests import ClientDisconnect
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from robomend.api.gate import SAFE, Bucket, by_name, foreign
from robomend.api.ingestion import PATH, RULE, Express
from robomend.api.problems import GONE, Problem, unforeseen
from robomend.api.protocol import LINGER_BYTES, LINGER_S
from robomend.api.shedding import LoadShedding
from robomend.logs import PRINCIPAL, REQUEST, debugging
from robomend.memory_limits import out_of_memory
from robomend.metrics import Metrics
from robomend.security import API

WITHOUT_HEAD = ("/events", "/actions/next")
"""Ends of paths that answer without end, or change something."""

NAMED = (b"application/json", b"application/x-ndjson")
"""Media types of answers that are named."""

NOT_KEPT = (b"cache-control", b"private, no-cache")
"""Unless a route says otherwise: keys decide who may read, and the next moment may be another."""

_DESCRIBE_A_BODY = frozenset({b"content-length", b"content-type"})


def head_as_get(scope: Scope) -> Scope:
    """Return a HEAD as the GET that it asks about, where it may be one; the server leaves the body out."""
    if scope["method"] != "HEAD" or scope["path"].endswith(WITHOUT_HEAD):
        return scope
    return {**scope, "method": "GET"}


class Conditional:
    """Sends the answer to a GET below the API, or says that the client has it."""

    def __init__(self, if_none_match: bytes | None, send: Send) -> None:
        self._asked = if_none_match
        self._send = send
        self._start: Message | None = None

    async def __call__(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = dict(message.get("headers", ()))
            if message["status"] != 200 or not headers.get(b"content-type", b"").startswith(NAMED):
                await self._send(message)
                return
            if b"cache-control" not in headers:
                message["headers"] = [*message["headers"], NOT_KEPT]
            self._start = message
            return
        start, self._start = self._start, None
        if start is None:
            await self._send(message)
            return
        if not message.get("more_body"):
            message = self._named(start, message)
        await self._send(start)
        await self._send(message)

    def _named(self, start: Message, message: Message) -> Message:
        """Give the answer its name; return its body, or none."""
        headers = start["headers"]
        tag = next((value for name, value in headers if name == b"etag"), None)
        if tag is None:
            digest = hashlib.sha256(message.get("body", b"")).hexdigest()[:32]
            tag = f'"{digest}"'.encode()
            headers = start["headers"] = [*headers, (b"etag", tag)]
        if self._asked is None or not _names(self._asked, tag):
            return message
        start["status"] = 304
        start["headers"] = [one for one in headers if one[0] not in _DESCRIBE_A_BODY]
        return {**message, "body": b""}


def _names(asked: bytes, tag: bytes) -> bool:
    """Whether If-None-Match names this version; weakly compared, as RFC 9110 has it."""
    return any(one.strip().removeprefix(b"W/") in (tag, b"*") for one in asked.split(b","))


log = structlog.get_logger("robomend.http")

REQUEST_ID = re.compile(rb"[A-Za-z0-9._\-]{1,64}\Z")
VERSIONS = frozenset({"1.0", "1.1"})
CLOSE = (b"connection", b"close")
Header = tuple[bytes, bytes]
# An answer's own headers go before these: a form of a page without referrer comes with `Origin: null`.
SECURITY_HEADERS = ((b"x-content-type-options", b"nosniff"), (b"referrer-policy", b"no-referrer"))


class Edge:
    """ASGI middleware; see the module."""

    def __init__(
        self,
        app: ASGIApp,
        *,
        metrics: Metrics,
        express: Express | None,
        shedding: LoadShedding | None,
        once: bool = False,
    ) -> None:
        """With `once`, an answer ends its connection."""
        self._app = app
        self._express = express
        self._shedding = shedding
        self._metrics = metrics
        self._once = once
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
        whole = ends = False  # the request has come; the connection ends with its answer

        async def received() -> Message:
            nonlocal whole
            message = await receive()
            whole = not message.get("more_body", False)
            return message

        async def with_headers(message: Message) -> None:
            nonlocal status, ends
            if message["type"] == "http.response.start":
                status = message["status"]
                message["headers"] = headers = with_ours(message.get("headers", ()), scope)
                if self._once:
                    headers.append(CLOSE)
                ends = CLOSE in headers or _last(scope)
            elif ends and not whole and not message.get("more_body", False):
                await send({**message, "more_body": True})
                await _drop_rest(received)
                message = {"type": "http.response.body", "body": b""}
            await send(message)

        REQUEST.set(request_id)
        answer: Send = with_headers
        asked, scope = scope, head_as_get(scope)
        if scope["method"] == "GET" and scope["path"].startswith(API):
            answer = Conditional(by_name(scope).get(b"if-none-match"), answer)
        try:
            problem = refusal(scope)
            if problem is not None:
                await problem.response(request_id)(scope, received, answer)
            elif self._express is not None and self._express.takes(scope):
                await self._express(scope, received, answer)
            else:
                await self._app(scope, received, answer)
        except ClientDisconnect:
            status = status or GONE
        except Exception as error:  # noqa: BLE001  # a bug of ours: it is logged and has an answer
            response = _failed(scope, error)
            if status == 0:
                await response(scope, received, answer)
        finally:
            self._note(scope, asked["method"], status, time.perf_counter() - began)
            REQUEST.set(None)
            PRINCIPAL.set(None)

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


def _failed(scope: Scope, error: Exception) -> Response:
    """Return the answer to what nobody caught; the log tells more."""
    if out_of_memory(error):
        log.error("out of memory", method=scope["method"], path=scope["path"], detail=str(error))
    else:  # a bug of ours: the client gets its 500, the log the traceback
        log.error("unforeseen", method=scope["method"], path=scope["path"], exc_info=error)
    return unforeseen(scope["robomend.request_id"], error)


def refusal(scope: Scope) -> Problem | None:
    """Return why this request is not even looked at, or None."""
    headers, version = by_name(scope), scope["http_version"]
    if version not in VERSIONS:
        spoken = f"HTTP/{version} is not spoken here: HTTP/1.1 is"
        return Problem(505, spoken, headers={"Connection": "close"})
    # Whoever is before us may frame these otherwise, and take a body for requests.
    if b"transfer-encoding" in headers and (version == "1.0" or b"content-length" in headers):
        why = f"of HTTP/{version}, this Transfer-Encoding is not read here"
        return Problem(400, why, headers={"Connection": "close"})
    if scope["method"] in SAFE or (header := foreign(scope)) is None:
        return None
    return Problem(
        403, f"a change may not come from a page of another origin ({header})", code="cross-origin"
    )


def _last(scope: Scope) -> bool:
    """Return whether the client wants no other answer on this connection."""
    return scope["http_version"] == "1.0" or by_name(scope).get(b"connection", b"").lower() == b"close"


async def _drop_rest(receive: Receive) -> None:
    """Read what still comes of a request that is answered, for a moment."""
    size, more = 0, True
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(LINGER_S):
            while more and size < LINGER_BYTES:
                message = await receive()
                size += len(message.get("body", b""))
                more = message.get("more_body", False)
