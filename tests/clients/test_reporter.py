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

from robomend_client.agent.reporter import VerdictReporter
from robomend_client.buffer import DiskBuffer
from robomend_client.literals import Atom, Literal
from robomend_client.observers import Change, Verdict
from robomend_client.outbox import Outbox
from robomend_client.rest import AsyncClient

SCAN, ODOM = Atom("ok", ("scan",)), Atom("ok", ("odom",))


class Seen:
    """What the observers of a test say."""

    def __init__(self) -> None:
        self.standing: dict[Atom, Verdict] = {}
        self.reporter: VerdictReporter | None = None

    def say(self, *changes: Change) -> None:
        assert self.reporter is not None
        for change in changes:
            if change.value is None:
                self.standing.pop(change.atom, None)
            else:
                self.standing[change.atom] = Verdict(change.value, change.since_ns or 0, change.onset_ns)
        self.reporter.report(changes)


def good(atom: Atom, time_ns: int, since_ns: int = 1) -> Change:
    return Change(time_ns, atom, Literal(atom), since_ns)


def bad(atom: Atom, time_ns: int, since_ns: int = 1, onset_ns: int | None = None) -> Change:
    return Change(time_ns, atom, -Literal(atom), since_ns, onset_ns)


Test = Callable[[Seen, "asyncio.Task[None]", list[dict[str, Any]]], Awaitable[None]]


def reporting(
    tmp_path: Path,
    test: Test,
    heartbeat_s: float = 0.2,
    on_batch: Callable[[], None] = lambda: None,
    answers: dict[str, Any] | None = None,
) -> list[dict[str, Any]]:
    """Run a reporter beside `test`; return the batches that a service, played by a transport, got."""
    got: list[dict[str, Any]] = []

    async def answer(request: httpx.Request) -> httpx.Response:
        await asyncio.sleep(0)
        got.append(json.loads(request.content))
        on_batch()
        return httpx.Response(200, json={"revision": len(got), "changed": [], **(answers or {})})

    async def run() -> None:
        buffer = DiskBuffer(tmp_path)
        async with AsyncClient("http://service", transport=httpx.MockTransport(answer)) as client:
            seen = Seen()
            outbox = Outbox(client, "r", buffer)
            seen.reporter = VerdictReporter(
                outbox, "agent", heartbeat_s, 1, lambda: list(seen.standing.values())
            )
            task = asyncio.create_task(seen.reporter.run())
            try:
                await asyncio.wait_for(test(seen, task, got), 60)
            finally:
                task.cancel()
                await asyncio.wait({task}, timeout=60)
        buffer.close()

    asyncio.run(run())
    return got


async def until(true: Callable[[], object]) -> None:
    while not true():
        await asyncio.sleep(0.005)


def test_what_stands_is_said_again_while_changes_come_faster_than_they_are_taken(tmp_path: Path) -> None:
    times = iter(range(100, 10**9))
    flapping: list[Seen] = []

    def two_more() -> None:
        for time_ns, seen in [(next(times), seen) for seen in flapping for _ in range(2)]:
            seen.say((good if time_ns % 2 else bad)(ODOM, time_ns))

    async def test(seen: Seen, task: asyncio.Task[None], got: list[dict[str, Any]]) -> None:
        seen.say(bad(SCAN, 50))
        await until(lambda: got)
        flapping.append(seen)
        seen.say(bad(ODOM, 51))
        await until(lambda: sum("not ok(scan)" in batch["observations"] for batch in got) > 4)
        flapping.clear()

    got = reporting(tmp_path, test, on_batch=two_more)
    said = [one for batch in got for one in batch["observations"]]
    assert {"ok(odom)", "not ok(odom)"} <= set(said), "and what changed is said"


def test_what_became_unknown_is_said_once_and_not_repeated(tmp_path: Path) -> None:
    async def test(seen: Seen, task: asyncio.Task[None], got: list[dict[str, Any]]) -> None:
        seen.say(good(SCAN, 50), good(ODOM, 50))
        await until(lambda: got)
        seen.say(Change(60, SCAN, None))
        await until(lambda: got[-1]["observations"] == ["ok(odom)"])

    got = reporting(tmp_path, test)
    assert [(batch["observations"], batch["time"]) for batch in got if "unknown" in batch] == [([], 60)]
    assert [batch["unknown"] for batch in got if "unknown" in batch] == [["ok(scan)"]]


def test_what_was_judged_anew_and_is_bad_is_said_again_before_the_next_heartbeat(tmp_path: Path) -> None:
    async def test(seen: Seen, task: asyncio.Task[None], got: list[dict[str, Any]]) -> None:
        seen.say(good(ODOM, 50))
        await until(lambda: len(got) >= 2)  # the change, and the only heartbeat of an hour
        seen.say(bad(SCAN, 60, 55, 54)._replace(settled=7))
        seen.standing[SCAN] = Verdict(-Literal(SCAN), 70, 54)
        await until(lambda: len(got) >= 5)
        seen.say(good(SCAN, 80), bad(ODOM, 80))
        await until(lambda: any("ok(scan)" in batch["observations"] for batch in got))

    got = reporting(tmp_path, test, heartbeat_s=3600)[2:]
    assert (got[0]["observations"], got[0]["since"], got[0]["settled"]) == (["not ok(scan)"], [55], 7)
    again = [batch for batch in got[1:] if "ok(scan)" not in batch["observations"]]
    assert len(again) >= 2
    assert all((one["observations"], one["since"]) == (["not ok(scan)"], [70]) for one in again)
    assert not any("settled" in one for one in again)
    assert got[-1]["observations"] == ["ok(scan)", "not ok(odom)"]  # of its own, and not followed any more


def test_a_sentence_that_the_service_does_not_keep_does_not_set_the_stamps_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_ns = [1_800_000_000 * 10**9]
    monkeypatch.setattr(time, "time_ns", lambda: now_ns[0])
    refused = {"sentence": "ok(scan)", "message": "the model does not declare it"}

    async def test(seen: Seen, task: asyncio.Task[None], got: list[dict[str, Any]]) -> None:
        seen.say(good(SCAN, now_ns[0]))
        await until(lambda: len(got) > 2)
        now_ns[0] -= 3600 * 10**9
        more = len(got) + 5
        await until(lambda: len(got) > more)

    got = reporting(tmp_path, test, heartbeat_s=0.02, answers={"refused": [refused]})
    times = [batch["time"] for batch in got]
    assert times == sorted(times)
