"""Requests that take longer than a key is known to be good: they end with their key.

    a body that comes slowly     looked at while it comes, before anything is done with it (read_chunks)
    a long poll                  looked at while it waits (`while_admitted`)
    a stream of events           looks for itself (robomend.api.streams)

The gate leaves in the request's scope how it is asked again.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

from starlette.requests import Request

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
    """Cut off the wait in the block when its key is revoked.

    Raises:
        Problem: 401, the answer then.
    """
    waiting = asyncio.current_task()
    assert waiting is not None
    refusal: list[Problem] = []

    async def look() -> None:
        while True:
            await asyncio.sleep(LOOK_S)
            try:
                await look_again(request)
            except Problem as problem:
                refusal.append(problem)
                waiting.cancel()
                return

    looking = asyncio.create_task(look(), name="still admitted")
    try:
        yield
    except asyncio.CancelledError:
        if refusal and waiting.uncancel() == 0:
            raise refusal[0] from None
        raise
    finally:
        looking.cancel()
