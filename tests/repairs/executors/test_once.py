"""A repeated action id gets the first result."""

from __future__ import annotations

import asyncio

import pytest

from robomend.repairs.executors.registry import Once
from robomend_client.actions import Action, ActionResult, Feedback

pytestmark = pytest.mark.anyio


class Counting:
    """Answers with how often it was called."""

    def __init__(self) -> None:
        self.calls = 0
        self.let_go = asyncio.Event()

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        self.calls += 1
        await self.let_go.wait()
        return ActionResult(self.calls, action.id)


def quiet(code: int, message: str) -> None:
    pass


async def test_the_second_call_gets_the_first_result() -> None:
    inner = Counting()
    inner.let_go.set()
    once = Once(inner)
    action = Action("r-1:0", "power_up", ("lidar",), 1.0)
    assert await once.execute(action, quiet) == await once.execute(action, quiet) == ActionResult(1, "r-1:0")
    assert inner.calls == 1


async def test_a_call_during_the_first_waits_for_it() -> None:
    inner = Counting()
    once = Once(inner)
    action = Action("r-1:0", "power_up", ("lidar",), 1.0)
    both = [asyncio.create_task(once.execute(action, quiet)) for _ in range(2)]
    await asyncio.sleep(0)
    inner.let_go.set()
    assert {result.code for result in await asyncio.gather(*both)} == {1}


async def test_a_cancelled_call_leaves_no_result() -> None:
    inner = Counting()
    once = Once(inner)
    action = Action("r-1:0", "power_up", ("lidar",), 1.0)
    task = asyncio.create_task(once.execute(action, quiet))
    await asyncio.sleep(0)
    task.cancel()
    await asyncio.wait([task])
    inner.let_go.set()
    assert (await once.execute(action, quiet)).code == 2
