"""Answers that a client has already: ETag and 304 for what is read (RFC 9110, 13.1.2), and HEAD.

Each answer to a GET in JSON or NDJSON is named by what is in it. A client that polls sends the name back as
If-None-Match and gets a 304 without a body while nothing has changed. What it saves is the way, not the work.
A resource that can be replaced names its versions itself, for If-Match.
"""

from __future__ import annotations

import hashlib

from starlette.types import Message, Scope, Send

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
