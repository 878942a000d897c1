"""Request bodies: how large, how slow, in which form.

A body is cut off as soon as it is larger than allowed, whether or not it says so itself (413), and given up
when nothing comes for a while (408): a client that sends a byte a minute must not hold memory for ever.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

from starlette.requests import ClientDisconnect, Request

from robomend.api import strict_json
from robomend.api.problems import Problem
from robomend.settings import Settings


class StrictRequest(Request):
    """A request whose JSON body was read with limits; see the module."""

    def __init__(self, request: Request, settings: Settings) -> None:
        super().__init__(request.scope, request.receive)
        self._settings = settings
        self._bytes = b""
        self._value: Any = None

    async def read(self, limit: int) -> None:
        """Read and parse the body, before the framework asks for it:
        it would take our Problems for its own.
        """
        chunks = [chunk async for chunk in read_chunks(self, limit, self._settings.body_timeout_s)]
        self._bytes = b"".join(chunks)
        if self._bytes:
            check_content_type(self, "application/json")
            self._value = strict_json.loads(self._bytes, self._settings.max_nesting)

    async def body(self) -> bytes:
        return self._bytes

    async def json(self) -> Any:
        return self._value


def content_type(request: Request) -> str:
    """Return the media type of the body without its parameters."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


def check_content_type(request: Request, *allowed: str) -> None:
    """Refuse a body of another kind with 415."""
    if content_type(request) not in allowed:
        given = request.headers.get("content-type", "")[:100] or "no content type"
        raise Problem(415, f"the body must be {' or '.join(allowed)}, not {given}")


async def read_chunks(request: Request, limit: int, timeout_s: float) -> AsyncIterator[bytes]:
    """Yield a body as it comes, up to `limit` bytes.

    Raises:
        Problem: 413 when there is more, 408 when it stalls, 400 when the client goes away in the middle.
    """
    declared = request.headers.get("content-length")
    if declared is not None and declared.isdigit() and int(declared[:20]) > limit:
        raise Problem(
            413, f"the body has {declared} bytes; at most {limit} are taken", headers={"Connection": "close"}
        )
    size = 0
    more = True
    while more:
        try:
            async with asyncio.timeout(timeout_s):
                message = await request.receive()
        except TimeoutError as error:
            problem = Problem(408, f"nothing came for {timeout_s:g} s", headers={"Connection": "close"})
            raise problem from error
        if message["type"] == "http.disconnect":
            raise ClientDisconnect
        chunk = message.get("body", b"")
        more = message.get("more_body", False)
        size += len(chunk)
        if size > limit:
            raise Problem(413, f"the body has more than {limit} bytes", headers={"Connection": "close"})
        if chunk:
            yield chunk
