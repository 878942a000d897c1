"""Actions that an agent pulls: handed out, answered once, withdrawn when nobody comes."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from tests.repairs.executors.test_board import quiet
from tests.store.examples import with_robots

from robomend.errors import Fenced, StateConflict
from robomend.repairs.agent_queue import AgentQueue
from robomend.repairs.executors.agent import AgentExecutor
from robomend.store import Store, agent_actions, global_stop
from robomend.store.records import Fence
from robomend_client.actions import CANCELLED, OK, TIMED_OUT, UNREACHABLE, Action, ActionResult

pytestmark = pytest.mark.anyio


@pytest.fixture
async def store(tmp_path: Path) -> AsyncIterator[Store]:
    store = Store(f"sqlite:///{tmp_path}/robomend.db")
    await store.start()
    await with_robots(store, "r1")
    yield store
    await store.close()


@pytest.fixture
async def queue(store: Store) -> AsyncIterator[AgentQueue]:
    queue = AgentQueue(store)
    queue.start()
    yield queue
    await queue.close()


def sent(store: Store, queue: AgentQueue, timeout_s: float, id: str = "r-1:0") -> asyncio.Task[ActionResult]:
    """Send start_node(driver) to the agent on nuc."""
    executor = AgentExecutor(queue, "r1", {"driver": "nuc"})
    return asyncio.create_task(executor.execute(Action(id, "start_node", ("driver",), timeout_s), quiet))


async def test_the_agent_on_the_component_s_host_gets_it_and_its_answer_counts(
    store: Store, queue: AgentQueue
) -> None:
    result = sent(store, queue, 10.0)
    assert await queue.take("r1", "other", 0.2) is None
    action = await queue.take("r1", "nuc", 5.0)
    assert action is not None
    assert (action.id, action.name, action.parameters) == ("r-1:0", "start_node", ("driver",))
    await queue.feedback(action.id, 0, "begun")
    await queue.finish(action.id, OK, "started")
    assert await result == ActionResult(OK, "started")


async def test_an_action_that_returns_twice_keeps_its_first_result(store: Store, queue: AgentQueue) -> None:
    result = sent(store, queue, 10.0)
    action = await queue.take("r1", "nuc", 5.0)
    assert action is not None
    await queue.finish(action.id, 7, "no such node")
    second = await queue.finish(action.id, OK, "started after all")
    assert (second.code, second.message) == (7, "no such node")
    assert await result == ActionResult(7, "no such node")
    assert await sent(store, queue, 10.0) == ActionResult(7, "no such node")  # the same id again


async def test_nobody_there_means_that_it_did_not_act(store: Store, queue: AgentQueue) -> None:
    result = await sent(store, queue, 0.2)
    assert result.code == UNREACHABLE
    assert result.message == "the agent on nuc did not take it within 0.2 s"
    assert await queue.take("r1", "nuc", 0.1) is None  # withdrawn: too late
    with pytest.raises(StateConflict):
        await queue.feedback("r-1:0", 0, "begun")


async def test_an_agent_that_begins_and_never_reports_leaves_the_outcome_unknown(
    store: Store, queue: AgentQueue
) -> None:
    result = sent(store, queue, 3.0)
    action = await queue.take("r1", "nuc", 5.0)
    assert action is not None
    await queue.feedback(action.id, 0, "begun")
    assert (await result).code == TIMED_OUT


async def test_halting_tells_the_agent_that_is_at_it(store: Store, queue: AgentQueue) -> None:
    halt = asyncio.Event()
    executor = AgentExecutor(queue, "r1", {}, halt)
    result = asyncio.create_task(executor.execute(Action("r-1:0", "start_node", ("driver",), 10.0), quiet))
    await queue.take("r1", "nuc", 5.0)
    await queue.feedback("r-1:0", 0, "begun")
    await queue.feedback("r-1:0", 0, "begun")  # a second later, still wanted
    halt.set()
    result.cancel()
    await asyncio.wait({result})
    with pytest.raises(StateConflict):
        await queue.feedback("r-1:0", 0, "begun")
    late = await queue.finish("r-1:0", OK, "started after all")
    assert late.code == CANCELLED


async def test_an_agent_that_is_at_it_goes_on_when_only_the_service_ends(
    store: Store, queue: AgentQueue
) -> None:
    result = sent(store, queue, 10.0)
    await queue.take("r1", "nuc", 5.0)
    await queue.feedback("r-1:0", 0, "begun")
    result.cancel()
    await asyncio.wait({result})
    await queue.feedback("r-1:0", 0, "at it")  # is not told that it is withdrawn
    assert (await queue.finish("r-1:0", OK, "started")).code == OK


async def test_nothing_is_handed_out_while_the_global_stop_is_active(store: Store, queue: AgentQueue) -> None:
    """An agent may be faster than the owner, who withdraws what waits: after a crash, say."""
    result = sent(store, queue, 60.0)
    while not await store.read(agent_actions.waiting, "r1"):
        await asyncio.sleep(0.01)
    await store.write(lambda tx: global_stop.put(tx, True, by="bob", reason="smoke"))
    assert await queue.take("r1", "nuc", 0.2) is None
    await store.write(lambda tx: global_stop.put(tx, False, by="bob", reason=""))
    assert await queue.take("r1", "nuc", 30.0) is not None
    await queue.finish("r-1:0", OK, "started")
    assert (await result).ok


async def test_nothing_is_queued_by_who_has_lost_the_robot(store: Store, queue: AgentQueue) -> None:
    executor = AgentExecutor(queue, "r1", {}, fence=Fence("r1", 7))
    with pytest.raises(Fenced):
        await executor.execute(Action("r-1:0", "start_node", ("driver",), 30.0), quiet)
    assert await store.read(agent_actions.waiting, "r1") == ()
