"""What the agent tells the service, and when."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import httpx
import pytest

from robomend_client.agent.reporter import Reporter
from robomend_client.buffer import DiskBuffer
from robomend_client.clock import Clock
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
            await asyncio.sleep(0.01)  # less than a heartbeat

    assert len(reporting(tmp_path, test)) <= 4


@pytest.mark.parametrize("turns", range(6))
def test_a_cancellation_that_comes_with_a_change_is_not_swallowed(tmp_path: Path, turns: int) -> None:
    async def test(reporter: Reporter, task: asyncio.Task[None], got: list[Any]) -> None:
        await asyncio.sleep(0.05)  # it waits for a change
        reporter.update([SCAN], [holds("ok", "scan")])
        for _ in range(turns):
            await asyncio.sleep(0)
        task.cancel()
        await asyncio.wait({task}, timeout=5)
        assert task.cancelled()

    reporting(tmp_path, test)


HOUR_NS = 3600 * 10**9


class WallClock:
    """The computer's clock, to be set by a test."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.ns = 1_800_000_000 * 10**9
        monkeypatch.setattr(time, "time_ns", lambda: self.ns)


def test_stamps_go_on_when_the_computers_clock_is_set_back(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = WallClock(monkeypatch)
    stamps = Clock()
    first = stamps.now_ns()
    clock.ns -= HOUR_NS
    later = [stamps.now_ns() for _ in range(1000)]
    assert first <= later[0]
    assert later == sorted(later)
    assert later[0] < later[-1]
    clock.ns += 2 * HOUR_NS
    assert stamps.now_ns() >= clock.ns


def test_stamps_that_the_service_refuses_follow_the_computers_clock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = WallClock(monkeypatch)
    right_ns = clock.ns
    clock.ns += HOUR_NS  # wrong at first, and mended later
    stamped: list[int] = []

    def answer(request: httpx.Request) -> httpx.Response:
        at = json.loads(request.content)["time"]
        stamped.append(at)
        ahead = at > right_ns + HOUR_NS // 60
        return httpx.Response(422 if ahead else 200, json={"code": "bad-input"} if ahead else {"revision": 1})

    async def run() -> None:
        buffer = DiskBuffer(tmp_path)
        async with AsyncClient("http://service", transport=httpx.MockTransport(answer)) as client:
            outbox = AsyncOutbox(client, "r", buffer)
            reporter = Reporter(outbox, "agent", heartbeat_s=0.02, lifetime_s=1)
            reporter.update([SCAN], [holds("ok", "scan")])
            task = asyncio.create_task(reporter.run())
            try:
                async with asyncio.timeout(20):
                    await until(lambda: outbox.refused)
                    clock.ns -= HOUR_NS
                    await until(lambda: right_ns <= stamped[-1] < right_ns + HOUR_NS // 60)
            finally:
                task.cancel()
                await asyncio.wait({task}, timeout=5)
        buffer.close()

    asyncio.run(run())
