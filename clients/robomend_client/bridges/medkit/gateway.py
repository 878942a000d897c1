"""The gateway's HTTP, as far as it is needed: lists, the stream of faults, transitions."""

from __future__ import annotations

import json
import os
from collections.abc import AsyncIterator
from typing import Any

import httpx

from robomend_client.rest.errors import NotTheService
from robomend_client.rest.sse import EventDecoder, ServerSentEvent

MOST_BYTES = 8 * 1024 * 1024
"""Of one answer."""

SILENCE_S = 75.0
"""The stream has a comment every 30 s; two missed ones mean a dead connection."""


class NoGateway(Exception):
    """The gateway is away, refuses, or is none; the message says which."""


class Gateway:
    """One gateway."""

    def __init__(self, url: str, token_env: str | None, timeout_s: float) -> None:
        """`url` as far as /api/v1; `token_env` names the variable with the bearer token."""
        token = os.environ.get(token_env, "").strip() if token_env else ""
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._client = httpx.AsyncClient(base_url=url.rstrip("/"), headers=headers, timeout=timeout_s)

    async def items(self, path: str) -> list[Any]:
        """Return what a list has.

        Raises:
            NoGateway: there is no answer, or no list.
        """
        found = await self.get(path)
        items = found.get("items")
        if not isinstance(items, list):
            raise NoGateway(f"{path} has no list of items")
        return items

    async def get(self, path: str) -> dict[str, Any]:
        """Return an object."""
        try:
            async with self._client.stream("GET", path) as response:
                body = b""
                async for part in response.aiter_bytes():
                    body += part
                    if len(body) > MOST_BYTES:
                        raise NoGateway(f"{path} has more than {MOST_BYTES} bytes")
        except (httpx.HTTPError, httpx.InvalidURL) as error:
            raise _unanswered(path, error) from error
        if response.status_code != 200:
            raise NoGateway(f"{path} is answered with {response.status_code}")
        try:
            found = json.loads(body)
        except (ValueError, RecursionError) as error:
            raise NoGateway(f"{path} is no JSON") from error
        if not isinstance(found, dict):
            raise NoGateway(f"{path} is no object")
        return found

    async def put(self, path: str) -> int:
        """Ask for a transition; return the answer's code."""
        try:
            return (await self._client.put(path)).status_code
        except (httpx.HTTPError, httpx.InvalidURL) as error:
            raise _unanswered(path, error) from error

    async def stream(self, path: str, decoder: EventDecoder) -> AsyncIterator[list[ServerSentEvent]]:
        """Yield the events of a stream, from where the decoder is; first of all, none: it is open."""
        headers = {"Accept": "text/event-stream"}
        if decoder.last_id:
            headers["Last-Event-ID"] = decoder.last_id
        decoder.reconnected()
        patience = httpx.Timeout(10.0, read=SILENCE_S)
        try:
            async with self._client.stream("GET", path, headers=headers, timeout=patience) as response:
                kind = response.headers.get("content-type", "")
                if response.status_code != 200 or not kind.startswith("text/event-stream"):
                    raise NoGateway(f"{path} is answered with {response.status_code}, {kind or 'no type'}")
                yield []
                async for data in response.aiter_bytes():
                    yield list(decoder.receive(data))
        except (httpx.HTTPError, httpx.InvalidURL, NotTheService) as error:
            raise _unanswered(path, error) from error

    async def close(self) -> None:
        await self._client.aclose()


def _unanswered(path: str, error: Exception) -> NoGateway:
    if isinstance(error, httpx.TimeoutException):  # it has no text of its own
        return NoGateway(f"{path}: no answer in time")
    return NoGateway(f"{path}: {str(error) or type(error).__name__}")
