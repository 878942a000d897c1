"""Request bodies: how large, how slow, in which form.

A body is cut off as soon as it is larger than allowed, whether or not it says so itself (413), and given up
when nothing comes for a while (408): a client that sends a byte a minute must not hold memory for ever.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from typing import Any

from starlette.requests import ClientDisconnect, Request

from robomend.api import strict_json
from robomend.api.admitted import LOOK_S, look_again
from robomend.api.problems import Problem
from robomend.robots.readers import Readers
from robomend.settings import Settings

BYTES_PER_S = 4096.0
"""Of a JSON body or a model, on average, after the first pause; a slower link sends NDJSON."""


class StrictRequest(Request):
    """A request whose JSON body was read with limits; see the module."""

    def __init__(self, request: Request, settings: Settings, readers: Readers) -> None:
        super().__init__(request.scope, request.receive)
        self._settings = settings
        self._readers = readers
        self._bytes = b""
        self._value: Any = None

    async def read(self, limit: int, timeout_s: float | None = None) -> None:
        """Read and parse the body, before the framework asks for it:
        it would take our Problems for its own.
        """
        timeout_s = timeout_s or self._settings.body_timeout_s
        chunks = [chunk async for chunk in read_chunks(self, limit, timeout_s, BYTES_PER_S)]
        self._bytes = b"".join(chunks)
        if self._bytes:
            check_content_type(self, "application/json")
            self._value = await strict_json.loads_in_turn(
                self._bytes, self._settings.max_nesting, self._readers
            )

    async def body(self) -> bytes:
        return self._bytes

    async def json(self) -> Any:
        return self._value


def content_type(request: Request) -> str:
    """Return the media type of the body without its parameters."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


def check_encoding(request: Request) -> None:
    """Refuse a compressed body with 415: a kilobyte may unfold into a gigabyte."""
    encoding = request.headers.get("content-encoding", "identity")
    if encoding.strip().lower() != "identity":
        raise Problem(
            415,
            f"the body is encoded as {encoding[:40]!r}; it is taken as it is only",
            headers={"Accept-Encoding": "identity"},
        )


def check_content_type(request: Request, *allowed: str) -> None:
    """Refuse a body of another kind with 415."""
    if content_type(request) not in allowed:
        given = request.headers.get("content-type", "")[:100] or "no content type"
        raise Problem(415, f"the body must be {' or '.join(allowed)}, not {given}")


async def read_chunks(
    request: Request, limit: int, timeout_s: float, bytes_per_s: float | None = None
) -> AsyncIterator[bytes]:
    """Yield a body as it comes, up to `limit` bytes.

    Args:
        timeout_s: the longest pause.
        bytes_per_s: if given, what it must come to on average, after the first `timeout_s`.

    Raises:
        Problem: 413 when there is more, 408 when it stalls, 415 when it is compressed, 401 when its key was
            revoked meanwhile.
        ClientDisconnect: the client went away in the middle.
    """
    check_encoding(request)
    declared = request.headers.get("content-length")
    if declared is not None and declared.isdigit() and int(declared[:20]) > limit:
        raise Problem(
            413, f"the body has {declared} bytes; at most {limit} are taken", headers={"Connection": "close"}
        )
    size = 0
    more = True
    began = looked = time.monotonic()
    while more:
        wait_s = timeout_s
        if bytes_per_s is not None:
            wait_s = min(wait_s, began + timeout_s + size / bytes_per_s - time.monotonic())
        try:
            async with asyncio.timeout(wait_s):
                message = await request.receive()
        except TimeoutError as error:
            slow = f"the body came too slowly: {size} bytes in {time.monotonic() - began:.0f} s"
            raise Problem(408, slow, headers={"Connection": "close"}) from error
        if message["type"] == "http.disconnect":
            raise ClientDisconnect
        if time.monotonic() - looked > LOOK_S:
            await look_again(request)
            looked = time.monotonic()
        chunk = message.get("body", b"")
        more = message.get("more_body", False)
        size += len(chunk)
        if size > limit:
            raise Problem(413, f"the body has more than {limit} bytes", headers={"Connection": "close"})
        if chunk:
            yield chunk
