"""What the agent tells the service, and when."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import httpx
import pytest

from robomend_client.agent.reporter import Reporter
from robomend_client.buffer import DiskBuffer
from robomend_client.literals import Atom, fails, holds
from robomend_client.outbox import AsyncOutbox
from robomend_client.rest import AsyncClient

SCAN, ODOM = Atom("ok", ("scan",)), Atom("ok", ("odom",))


def reporting(
    tmp_path: Path, test: Callable[[Reporter, asyncio.Task[None], list[Any]], Awaitable[None]]
) -> list[Any]:
    """Run a reporter beside `test`; return the batches that a service, played by a transport, got."""
    got: list[Any] = []

    def answer(request: httpx.Request) -> httpx.Response:
        got.append(json.loads(request.content)["observations"])
        return httpx.Response(200, json={"revision": len(got), "changed": []})

    async def run() -> None:
        buffer = DiskBuffer(tmp_path)
        async with AsyncClient("http://service", transport=httpx.MockTransport(answer)) as client:
            reporter = Reporter(AsyncOutbox(client, "r", buffer), "agent", heartbeat_s=0.2, lifetime_s=1)
            task = asyncio.create_task(reporter.run())
            try:
                await asyncio.wait_for(test(reporter, task, got), 20)
            finally:
                task.cancel()
                await asyncio.wait({task}, timeout=5)
        buffer.close()

    asyncio.run(run())
    return got


async def until(true: Callable[[], object]) -> None:
    while not true():
        await asyncio.sleep(0.005)


def test_a_change_is_said_at_once_and_everything_in_the_heartbeat(tmp_path: Path) -> None:
    async def test(reporter: Reporter, task: asyncio.Task[None], got: list[Any]) -> None:
        reporter.update([SCAN, ODOM], [holds("ok", "scan"), holds("ok", "odom")])
        await until(lambda: len(got) >= 2)
        reporter.update([SCAN, ODOM], [fails("ok", "scan"), holds("ok", "odom")])
        await until(lambda: ["not ok(scan)"] in got)
        await until(lambda: got[-1] == ["not ok(scan)", "ok(odom)"])

    assert reporting(tmp_path, test)[0] == ["ok(scan)", "ok(odom)"]


def test_what_became_unknown_is_not_said_any_more(tmp_path: Path) -> None:
    async def test(reporter: Reporter, task: asyncio.Task[None], got: list[Any]) -> None:
        reporter.update([SCAN, ODOM], [holds("ok", "scan"), holds("ok", "odom")])
        reporter.update([SCAN], [])
        assert reporter.holding == (holds("ok", "odom"),)
        await until(lambda: got and got[-1] == ["ok(odom)"])

    reporting(tmp_path, test)


def test_what_did_not_change_is_left_to_the_heartbeat(tmp_path: Path) -> None:
    async def test(reporter: Reporter, task: asyncio.Task[None], got: list[Any]) -> None:
        for _ in range(30):
            reporter.update([SCAN], [holds("ok", "scan")])
            await asyncio.sleep(0.01)

    assert len(reporting(tmp_path, test)) <= 4


@pytest.mark.parametrize("turns", range(6))
def test_a_cancellation_that_comes_with_a_change_is_not_swallowed(tmp_path: Path, turns: int) -> None:
    async def test(reporter: Reporter, task: asyncio.Task[None], got: list[Any]) -> None:
        await asyncio.sleep(0.05)
        reporter.update([SCAN], [holds("ok", "scan")])
        for _ in range(turns):
            await asyncio.sleep(0)
        task.cancel()
        await asyncio.wait({task}, timeout=5)
        assert task.cancelled()

    reporting(tmp_path, test)
