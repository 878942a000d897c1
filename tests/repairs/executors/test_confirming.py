"""Nothing is sent by who has lost the robot, whatever it would be sent by."""

from __future__ import annotations

import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from tests.repairs.executors.test_board import Board, quiet
from tests.store.examples import with_robots

from robomend import webhooks
from robomend.errors import Fenced
from robomend.repairs.agent_queue import AgentQueue
from robomend.repairs.executors.agent import AgentExecutor
from robomend.repairs.executors.board import BoardExecutor
from robomend.repairs.executors.process import ProcessExecutor
from robomend.repairs.executors.webhook import WebhookExecutor
from robomend.store import Store, agent_actions
from robomend.store.records import Fence
from robomend.webhooks import Webhook
from robomend_client.actions import Action

pytestmark = pytest.mark.anyio


async def lost() -> None:
    """Find out that another instance has taken over."""
    raise Fenced("r1 was taken over")


@pytest.fixture
async def store(tmp_path: Path) -> AsyncIterator[Store]:
    store = Store(f"sqlite:///{tmp_path}/robomend.db")
    await store.start()
    await with_robots(store, "r1")
    yield store
    await store.close()


async def test_no_frame_goes_to_a_board() -> None:
    board = Board()
    with pytest.raises(Fenced):
        await BoardExecutor(board, {"jaguar": 7}, {}, lost).execute(
            Action("r-1:0", "power_up", ("jaguar",), 1.0), quiet
        )
    assert board.told == []


async def test_no_program_is_started(tmp_path: Path) -> None:
    acted = tmp_path / "acted"
    program = [sys.executable, "-c", f"open({str(acted)!r}, 'w')"]
    with pytest.raises(Fenced):
        await ProcessExecutor({"reset": program}, lost).execute(Action("r-1:0", "reset", (), 30.0), quiet)
    assert not acted.exists()


async def test_no_webhook_is_called(monkeypatch: pytest.MonkeyPatch) -> None:
    called = []

    async def post(*arguments: object) -> None:
        called.append(arguments)

    monkeypatch.setattr(webhooks, "post", post)
    hooks = {"reset": Webhook("http://127.0.0.1:1/", "a secret", True)}
    with pytest.raises(Fenced):
        await WebhookExecutor(hooks, lost).execute(Action("r-1:0", "reset", (), 30.0), quiet)
    assert called == []


async def test_nothing_is_queued_for_an_agent(store: Store) -> None:
    queue = AgentQueue(store)
    executor = AgentExecutor(queue, "r1", {}, fence=Fence("r1", 7))
    with pytest.raises(Fenced):
        await executor.execute(Action("r-1:0", "start_node", ("driver",), 30.0), quiet)
    assert await store.read(agent_actions.waiting, "r1") == ()
