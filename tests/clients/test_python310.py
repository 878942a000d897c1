"""What Python 3.10 does not have: it behaves as the standard library's does from 3.11 on."""

from __future__ import annotations

import asyncio

import pytest
from tests.waiting import for_ever

from robomend_client.python310 import StrEnum, timeout


class Colour(StrEnum):
    RED = "red"


def test_an_enumeration_of_texts_is_text() -> None:
    assert (f"{Colour.RED}", str(Colour.RED), Colour("red")) == ("red", "red", Colour.RED)


def test_a_block_that_takes_too_long_is_a_time_out() -> None:
    async def late() -> None:
        async with timeout(0.01):
            await for_ever()

    with pytest.raises(TimeoutError):
        asyncio.run(late())


def test_a_block_that_is_in_time_is_left_alone() -> None:
    async def quick() -> str:
        async with timeout(30), timeout(None):
            await asyncio.sleep(0)
        await asyncio.sleep(0)
        return "done"

    assert asyncio.run(quick()) == "done"


def test_a_cancellation_from_outside_is_no_time_out() -> None:
    async def cancelled() -> bool:
        async def work() -> None:
            async with timeout(30):
                await for_ever()

        task = asyncio.create_task(work())
        await asyncio.sleep(0)
        task.cancel()
        await asyncio.wait([task])
        return task.cancelled()

    assert asyncio.run(cancelled())
