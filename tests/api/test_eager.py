"""A coroutine that begins at once is a task to what runs in it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextvars import ContextVar
from typing import Any

import pytest
import uvloop

from robomend.api.eager import Eager

NAME: ContextVar[str] = ContextVar("NAME", default="outside")

Run = Callable[[Callable[[set[Any]], Awaitable[None]]], None]


@pytest.fixture(params=[uvloop.run, asyncio.run], ids=["uvloop", "asyncio"])
def run(request: pytest.FixtureRequest) -> Run:
    """Both loops; what is begun is begun by a callback, as data that comes in is."""

    def run(main: Callable[[set[Any]], Awaitable[None]]) -> None:
        async def whole() -> None:
            await main(set())

        request.param(whole())

    return run


async def begun(work: Any, among: set[Any], note: Callable[[float], None] | None = None) -> Eager:
    """Begin it in a turn of the loop in which no task runs."""
    made: asyncio.Future[Eager] = asyncio.get_running_loop().create_future()
    loop = asyncio.get_running_loop()
    loop.call_soon(lambda: made.set_result(Eager(work, loop, among, note)))
    return await made


async def later() -> None:
    """Return when a callback of the loop has said so."""
    loop = asyncio.get_running_loop()
    future: asyncio.Future[None] = loop.create_future()
    loop.call_soon(future.set_result, None)
    await future


async def ended(eager: Eager, among: set[Any]) -> None:
    async with asyncio.timeout(30):
        while eager in among:
            await asyncio.sleep(0)


def test_it_begins_at_once_and_goes_on_when_what_it_waits_for_is_there(run: Run) -> None:
    async def main(among: set[Any]) -> None:
        seen: list[Any] = []
        future: asyncio.Future[str] = asyncio.get_running_loop().create_future()

        async def work() -> None:
            seen.append("began")
            seen.append(await future)
            await asyncio.sleep(0)
            seen.append("ended")

        loop = asyncio.get_running_loop()

        def begin() -> None:
            Eager(work(), loop, among)
            seen.append("behind it")

        loop.call_soon(begin)
        await asyncio.sleep(0)
        assert seen == ["began", "behind it"]
        [eager] = among
        future.set_result("went on")
        await ended(eager, among)
        assert seen == ["began", "behind it", "went on", "ended"]
        assert not eager.cancel()

    run(main)


def test_what_it_waits_for_may_fail(run: Run) -> None:
    async def main(among: set[Any]) -> None:
        caught: list[BaseException] = []
        future: asyncio.Future[None] = asyncio.get_running_loop().create_future()

        async def work() -> None:
            try:
                await future
            except ZeroDivisionError as error:
                caught.append(error)

        eager = await begun(work(), among)
        error = ZeroDivisionError()
        future.set_exception(error)
        await ended(eager, among)
        assert caught == [error]

    run(main)


def test_a_time_out_ends_a_wait_in_it(run: Run) -> None:
    async def main(among: set[Any]) -> None:
        seen: list[str] = []

        async def work() -> None:
            try:
                async with asyncio.timeout(0.01):
                    await asyncio.get_running_loop().create_future()
            except TimeoutError:
                seen.append("too late")
            async with asyncio.timeout(30):
                await asyncio.sleep(0)
            seen.append("in time")

        await ended(await begun(work(), among), among)
        assert seen == ["too late", "in time"]

    run(main)


@pytest.mark.parametrize("turns", [0, 1])
def test_a_cancelled_one_ends_where_it_waits(turns: int, run: Run) -> None:
    async def main(among: set[Any]) -> None:
        seen: list[str] = []

        async def work() -> None:
            try:
                while turns:
                    await asyncio.sleep(0)
                await asyncio.get_running_loop().create_future()
            except asyncio.CancelledError:
                seen.append("cancelled")
                raise

        eager = await begun(work(), among)
        assert eager.cancel(msg="as uvicorn does")
        assert eager.cancelling() == 1
        await ended(eager, among)
        assert seen == ["cancelled"]

    run(main)


def test_one_that_cancels_itself_ends_at_its_next_wait(run: Run) -> None:
    async def main(among: set[Any]) -> None:
        seen: list[str] = []

        async def work() -> None:
            current: Any = asyncio.current_task()
            current.cancel()
            seen.append("goes on")
            await asyncio.get_running_loop().create_future()
            seen.append("never")

        await ended(await begun(work(), among), among)
        assert seen == ["goes on"]

    run(main)


def test_it_has_a_context_of_its_own_to_the_end(run: Run) -> None:
    async def main(among: set[Any]) -> None:
        seen: list[str] = []

        async def work() -> None:
            seen.append(NAME.get())
            NAME.set("inside")
            await asyncio.sleep(0)
            seen.append(NAME.get())
            NAME.set("still inside")
            await later()
            seen.append(NAME.get())

        await ended(await begun(work(), among), among)
        assert seen == ["outside", "inside", "still inside"]
        assert NAME.get() == "outside"

    run(main)


def test_it_is_the_task_that_runs_and_none_is_when_it_waits(run: Run) -> None:
    async def main(among: set[Any]) -> None:
        seen: list[object] = []

        async def work() -> None:
            seen.append(asyncio.current_task())
            task = asyncio.create_task(asyncio.sleep(0))
            await task
            seen.append(asyncio.current_task())

        loop = asyncio.get_running_loop()
        after: list[object] = []

        def begin() -> None:
            Eager(work(), loop, among)
            after.append(asyncio.current_task())

        loop.call_soon(begin)
        await asyncio.sleep(0)
        [eager] = among
        await ended(eager, among)
        assert seen == [eager, eager]
        assert after == [None]

    run(main)


def test_a_bug_is_told_and_ends_it(run: Run) -> None:
    async def main(among: set[Any]) -> None:
        told: list[Any] = []
        asyncio.get_running_loop().set_exception_handler(lambda _, context: told.append(context["exception"]))

        async def work() -> None:
            await asyncio.sleep(0)
            raise ZeroDivisionError("a bug")

        await ended(await begun(work(), among), among)
        assert [str(error) for error in told] == ["a bug"]

    run(main)


def test_the_longest_hold_is_noted_once_at_the_end(run: Run) -> None:
    async def main(among: set[Any]) -> None:
        noted: list[float] = []
        before: list[int] = []

        async def work() -> None:
            sum(range(300_000))
            await asyncio.sleep(0)
            before.append(len(noted))

        await ended(await begun(work(), among, noted.append), among)
        assert before == [0]
        [longest_s] = noted
        assert longest_s > 0

    run(main)
