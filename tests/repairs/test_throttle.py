"""What comes in as often as it likes is told at most every so often, the latest of it in the end."""

from __future__ import annotations

import asyncio

import pytest

from robomend.repairs.throttle import Throttle

pytestmark = pytest.mark.anyio


async def test_the_first_is_told_at_once_and_the_latest_of_the_rest_after_the_period() -> None:
    told: list[int] = []
    latest = 0
    done = asyncio.Event()

    async def tell(key: str) -> None:
        told.append(latest)
        if len(told) == 2:
            done.set()

    throttle = Throttle[str](0.5, tell)
    for latest in range(100):  # noqa: B007  # `tell` reads it
        throttle.ask("a")
        await asyncio.sleep(0)
    async with asyncio.timeout(60):
        await done.wait()
    await throttle.close()
    assert told[-1] == 99
    assert len(told) == 2


async def test_each_key_has_its_own_turn() -> None:
    told: list[str] = []
    throttle = Throttle[str](60.0, lambda key: _note(told, key))
    throttle.ask("a")
    throttle.ask("b")
    await asyncio.sleep(0)
    assert sorted(told) == ["a", "b"]
    await throttle.close()


async def test_a_failure_does_not_end_the_telling() -> None:
    told: list[str] = []
    again = asyncio.Event()

    async def tell(key: str) -> None:
        told.append(key)
        if len(told) == 1:
            raise ValueError("the store is away")
        again.set()

    throttle = Throttle[str](0.01, tell)
    throttle.ask("a")
    await asyncio.sleep(0)
    throttle.ask("a")
    async with asyncio.timeout(60):
        await again.wait()
    await throttle.close()


async def _note(told: list[str], key: str) -> None:
    told.append(key)
