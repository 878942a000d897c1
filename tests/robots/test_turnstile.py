"""Waiting for a number to grow."""

from __future__ import annotations

import asyncio

import pytest

from robomend.robots.robot import Turnstile

pytestmark = pytest.mark.anyio


async def test_a_number_that_is_there_already_is_not_waited_for() -> None:
    assert await Turnstile(3).beyond(2, 60) == 3


async def test_everyone_who_waits_is_let_through_at_once() -> None:
    turnstile = Turnstile()
    waiting = [asyncio.create_task(turnstile.beyond(0, 60)) for _ in range(5)]
    await asyncio.sleep(0)
    turnstile.advance(7)
    assert await asyncio.gather(*waiting) == [7] * 5


async def test_the_wait_ends_with_what_there_is() -> None:
    assert await Turnstile(1).beyond(1, 0.01) == 1


async def test_a_number_never_shrinks() -> None:
    turnstile = Turnstile(5)
    turnstile.advance(4)
    assert turnstile.value == 5


async def test_a_wake_lets_go_without_news() -> None:
    turnstile = Turnstile(1)
    waiting = asyncio.create_task(turnstile.beyond(1, 60))
    await asyncio.sleep(0)
    turnstile.wake()
    assert await waiting == 1


async def test_whoever_gives_up_leaves_nothing_behind() -> None:
    turnstile = Turnstile()
    waiting = asyncio.create_task(turnstile.beyond(0, 60))
    await asyncio.sleep(0)
    waiting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await waiting
    turnstile.advance(1)  # wakes nobody, and does not fail
    assert turnstile.value == 1
