"""What reaches a running repair: a yes counts once, for the question it was given to."""

from __future__ import annotations

import asyncio

import pytest

from robomend.repairs.signals import Halted, Signals

pytestmark = pytest.mark.anyio


async def test_a_yes_that_comes_at_once_is_not_lost() -> None:
    signals = Signals()
    signals.ask()
    signals.approve(by="ann", request=1)
    assert await signals.decided(1.0)
    assert (signals.by, signals.answers(), signals.answers()) == ("ann", (1,), ())


async def test_a_yes_to_an_earlier_question_is_no_answer_to_a_new_one() -> None:
    signals = Signals()
    signals.approve(by="ann", request=1)
    signals.ask()
    signals.approve(by="ann", request=1)  # read from the store once more
    assert not await signals.decided(0.01)
    signals.approve(by="bob", request=2)
    assert await signals.decided(1.0)
    assert signals.answers() == (1, 2)


async def test_an_end_counts_for_more_than_a_yes_and_the_first_end_is_told() -> None:
    signals = Signals()
    signals.approve(by="ann", request=1)
    signals.end(by="bob", reason="I see smoke", request=2)
    signals.end(by="eve", reason="global stop: people on the floor", stop=True)
    assert not await signals.decided(1.0)
    assert (signals.by, signals.reason, signals.stopped) == ("bob", "I see smoke", False)


async def test_a_wait_ends_with_its_result_when_nobody_halts() -> None:
    async def answer() -> int:
        await asyncio.sleep(0)
        return 7

    assert await Signals().unless_halted(answer()) == 7


async def test_a_halt_ends_a_wait_that_would_never_end_and_cancels_it() -> None:
    signals = Signals()
    cancelled: list[bool] = []

    async def for_ever() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            cancelled.append(True)

    async with asyncio.timeout(30):
        waiting = asyncio.create_task(signals.unless_halted(for_ever()))
        await asyncio.sleep(0)
        signals.end(by="ann", reason="I see smoke")
        with pytest.raises(Halted):
            await waiting
    assert cancelled == [True]


async def test_what_fails_while_it_is_waited_for_fails_here() -> None:
    async def broken() -> None:
        raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"):
        await Signals().unless_halted(broken())


async def test_after_a_halt_nothing_is_waited_for() -> None:
    signals = Signals()
    signals.end(by="ann", reason="I see smoke")
    with pytest.raises(Halted):
        await signals.unless_halted(asyncio.sleep(0))
