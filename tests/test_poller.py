"""Whoever looks for work goes on looking, whatever a look meets."""

from __future__ import annotations

import asyncio

import pytest
from structlog.testing import capture_logs
from tests.waiting import eventually, for_ever

from robomend.errors import StoreError
from robomend.poller import Seeker

pytestmark = pytest.mark.anyio
NEVER_S = 3600.0


@pytest.mark.parametrize("error", [StoreError("away"), ZeroDivisionError()])
async def test_a_look_that_fails_is_told_and_the_next_one_comes(error: Exception) -> None:
    looks = 0

    async def look() -> None:
        nonlocal looks
        looks += 1
        if looks == 1:
            raise error

    seeker = Seeker(look, "work", 0.01)
    with capture_logs() as logs:
        seeker.start()
        await eventually(lambda: looks > 2, "looks go on")
    await seeker.close((), 1.0)
    assert [line["what"] for line in logs] == ["work"]


async def test_what_happens_during_a_look_is_looked_for_once_more() -> None:
    looks, goes_on = 0, asyncio.Event()

    async def look() -> None:
        nonlocal looks
        looks += 1
        await goes_on.wait()

    seeker = Seeker(look, "work", NEVER_S)
    seeker.start()
    await eventually(lambda: looks == 1, "the first look")
    seeker.wake()
    goes_on.set()
    await eventually(lambda: looks == 2, "the second look")
    await seeker.close((), 1.0)


async def test_a_look_may_say_when_to_look_again() -> None:
    looks = 0

    async def look() -> float:
        nonlocal looks
        looks += 1
        return 0.0

    seeker = Seeker(look, "work", NEVER_S)
    seeker.start()
    await eventually(lambda: looks > 1, "the next look")
    await seeker.close((), 1.0)


async def test_closing_ends_the_look_and_what_looks_began() -> None:
    looks, before = 0, asyncio.all_tasks()

    async def look() -> None:
        nonlocal looks
        looks += 1
        await for_ever()

    seeker = Seeker(look, "work", NEVER_S)
    begun = asyncio.create_task(for_ever())
    await seeker.close((), 1.0)  # it never began
    seeker.start()
    await eventually(lambda: looks == 1, "the look")
    await seeker.close([begun], 30.0)
    assert begun.cancelled()
    seeker.wake()
    assert asyncio.all_tasks() == before
