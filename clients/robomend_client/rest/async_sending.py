"""How calls are sent for asyncio: one answer, an answer piece by piece, a stream that is taken up again.

retry.py says what is sent again and when, errors.py what is raised, transport.py what is on the wire.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from types import TracebackType
from typing import IO, Any, TypeVar

import httpx

from robomend_client.events import Event
from robomend_client.rest.calls import Call
from robomend_client.rest.errors import (
    ApiError,
    ClientError,
    ServiceFailed,
    TooManyRequests,
    raise_for,
    translate,
)
from robomend_client.rest.retry import Attempts, Retry
from robomend_client.rest.transport import Connection, StreamState

T = TypeVar("T")
S = TypeVar("S", bound="AsyncSender")


class AsyncSender:
    """The connections to one service; AsyncClient has a method for each call."""

    def __init__(
        self,
        url: str,
        key: str | None = None,
        *,
        timeout_s: float = 30.0,
        retry: Retry | None = None,
        trust_env: bool = False,
        transport: httpx.AsyncBaseTransport | None = None,
    ) -> None:
        self._connection = Connection(url, key, timeout_s, trust_env)
        self._retry = retry or Retry()
        self._http = httpx.AsyncClient(transport=transport, **self._connection.options())

    async def __aenter__(self: S) -> S:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the connections; open event streams end."""
        await self._http.aclose()

    async def send(self, call: Call[T], retry: Retry | None = None) -> T:
        """Send one call and read its answer."""
        attempts = Attempts(retry or self._retry, call.repeatable)
        while True:
            try:
                response = await self._http.request(**self._connection.request(call))
                raise_for(response)
                return call.read(response)
            except httpx.TransportError as error:
                failure: ClientError = translate(error)
                failure.__cause__ = error
            except ApiError as error:
                failure = error
            await asyncio.sleep(attempts.after(failure))

    async def download(self, call: Call[Any], into: IO[bytes]) -> None:
        """Send one call, once, and write its answer piece by piece."""
        try:
            async with self._http.stream(**self._connection.request(call)) as response:
                if response.status_code != 200:
                    await response.aread()
                    raise_for(response)
                async for data in response.aiter_bytes():
                    into.write(data)
        except httpx.TransportError as error:
            raise translate(error) from error

    async def events(
        self,
        robot: str | None = None,
        *,
        after: int | str | None = None,
        patience_s: float | None = None,
        on_gap: Callable[[Mapping[str, Any]], None] | None = None,
        on_connection: Callable[[ClientError | None], None] | None = None,
    ) -> AsyncIterator[Event]:
        """Yield the events of one robot, or of the whole service, for ever:
        from now on, or after event `after`.

        A lost stream is taken up again with Last-Event-ID, so that nothing is missed that the service still
        keeps; when it does not, `on_gap` is told. `on_connection` is told with None that the stream stands,
        and with the reason that it is lost. After `patience_s` without a connection (None: never) the reason
        is raised.
        """
        stream = StreamState(robot, after, patience_s, on_gap, on_connection)
        while True:
            try:
                async with self._http.stream(**self._connection.stream(stream)) as response:
                    if response.status_code != 200:
                        await response.aread()
                        raise_for(response)
                    stream.connected(response)
                    async for data in response.aiter_bytes():
                        for event in stream.receive(data):
                            yield event
                failure: ClientError = stream.ended()
            except httpx.TransportError as error:
                failure = translate(error)
                failure.__cause__ = error
            except (ServiceFailed, TooManyRequests) as error:
                failure = error
            await asyncio.sleep(stream.after(failure))
