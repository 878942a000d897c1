"""Requests that take longer than a key is known to be good: they end with their key, and with their client.

    a body that comes slowly     looked at while it comes, before anything is done with it (read_chunks)
    a long poll                  looked at while it waits (`while_admitted`)
    a stream of events           looks for itself (robomend.api.streams)

A long poll whose client is gone would keep its place among those that may wait (`max_waiters`): when a
network comes back, a whole fleet asks anew, and must not be refused because of its own former questions.

The gate leaves in the request's scope how it is asked again.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

from starlette.requests import ClientDisconnect, Request
from starlette.types import Receive

from robomend.api.problems import Problem

AGAIN = "robomend.admit_again"
"""In a scope: a function that raises the Problem which a request with this scope has become."""

Again = Callable[[Request], Awaitable[object]]

LOOK_S = 2.0
"""Between two looks."""


async def look_again(request: Request) -> None:
    """Return if whoever was let in would be let in now. Problem (401): the key was revoked meanwhile."""
    again: Again | None = request.scope.get(AGAIN)
    if again is not None:
        await again(request)


@asynccontextmanager
async def while_admitted(request: Request) -> AsyncIterator[None]:
    """Cut off the wait in the block when its key is revoked, or its client is gone.

    Raises:
        Problem: 401, the answer then.
        ClientDisconnect: there is nobody to answer.
    """
    waiting = asyncio.current_task()
    assert waiting is not None
    ends: list[Exception] = []

    async def look() -> None:
        leaving = asyncio.ensure_future(left(request.receive))
        try:
            while not (await asyncio.wait({leaving}, timeout=LOOK_S))[0]:
                await look_again(request)
            ends.append(ClientDisconnect())
        except Problem as problem:
            ends.append(problem)
        finally:
            leaving.cancel()
        waiting.cancel()

    looking = asyncio.create_task(look(), name="still admitted")
    try:
        yield
    except asyncio.CancelledError:
        if ends and waiting.uncancel() == 0:
            raise ends[0] from None
        raise
    finally:
        looking.cancel()


async def left(receive: Receive) -> None:
    """Return when the client of a request has gone away."""
    while (await receive())["type"] != "http.disconnect":
        pass
