"""kill -9 of the whole service at random moments under load: what a client was told is kept, is kept."""

from __future__ import annotations

import asyncio
import json
import random
import sqlite3
from pathlib import Path

import pytest
from tests.postgres import postgres_server as postgres_server  # fixtures
from tests.postgres import postgres_url as postgres_url

from robomend.store import Store, View, events, observations
from robomend.store.records import Paging, StoredBatch
from robomend_bench.service.process import Served, model_text, start
from robomend_bench.service.wire import ServiceGone, connect, request

WRITERS = 32
ROBOTS = tuple(f"k{number}" for number in range(16))


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """The database of a test."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'robomend.db'}"
    found: str = request.getfixturevalue("postgres_url")
    return found


async def load(service: Served, round_: int, after_s: float) -> list[tuple[str, str]]:
    """Post until the service is killed, and return the (robot, marker) pairs that were acknowledged."""
    acknowledged: list[tuple[str, str]] = []
    connections = [await connect(service.url) for _ in range(WRITERS)]
    if round_ == 0:
        await connections[0].api("PUT", "/models/m", {"source": model_text()})
        for robot in ROBOTS:
            await connections[0].api("PUT", f"/robots/{robot}", {"model": "m"})

    async def write(number: int) -> None:
        robot, count = ROBOTS[number % len(ROBOTS)], 0
        while True:
            count += 1
            marker = f"{round_}-{number}-{count}"
            sentence = "not running(rviz)" if count % 2 else "running(rviz)"
            body = json.dumps({"observations": [sentence], "source": marker}).encode()
            try:
                wire = request("POST", f"/api/v1/robots/{robot}/observations", body)
                status, _ = await connections[number].ask(wire)
            except ServiceGone:
                return
            assert status in {200, 503}
            if status == 200:
                acknowledged.append((robot, marker))
            else:  # overloaded, and it says so: nothing of it is kept
                await asyncio.sleep(0.05)

    writers = asyncio.gather(*map(write, range(WRITERS)))
    async with asyncio.timeout(60):
        while round_ == 0 and not acknowledged:  # on a busy computer the first may take its time
            await asyncio.sleep(0.01)
    await asyncio.sleep(after_s)  # a random moment
    service.process.kill()
    async with asyncio.timeout(60):
        await writers
    return acknowledged


def whole_history(db: View, robot: str) -> list[StoredBatch]:
    """Return all batches of a robot, oldest first."""
    batches: list[StoredBatch] = []
    cursor: str | None = None
    while True:
        page = observations.history(db, robot, Paging(cursor, 1000))
        batches += page.items
        cursor = page.next
        if cursor is None:
            return batches[::-1]


def check(db: View, acknowledged: list[tuple[str, str]]) -> int:
    """Check that all of it is there, once; return the number of batches."""
    found: list[tuple[str, str]] = []
    for robot in ROBOTS:
        batches = whole_history(db, robot)
        assert [batch.revision for batch in batches] == list(range(1, observations.revision(db, robot) + 1))
        found += [(robot, batch.entries[0].source) for batch in batches]
    assert len(set(found)) == len(found)
    assert set(acknowledged) <= set(found)
    kept = events.kept(db)
    count = sum(1 for first in range(kept.oldest, kept.newest + 1, 500) for _ in events.after(db, first - 1))
    assert count == kept.newest - kept.oldest + 1  # without gaps
    return len(found)


async def look(url: str, acknowledged: list[tuple[str, str]]) -> int:
    """Look into the database as the next process would."""
    store = Store(url)
    await store.start()
    try:
        return await store.read(lambda db: check(db, acknowledged))
    finally:
        await store.close()


@pytest.mark.timeout(3600)
def test_nothing_acknowledged_is_lost_when_the_service_is_killed(
    url: str, tmp_path: Path, long: bool
) -> None:
    rounds, chance = (200 if long else 3), random.Random(11)
    acknowledged: list[tuple[str, str]] = []
    for round_ in range(rounds):
        service = start(tmp_path, ["--database", url])
        try:
            acknowledged += asyncio.run(load(service, round_, chance.uniform(0.05, 0.8)))
        finally:
            service.process.kill()
            service.process.wait(60)
            assert service.process.stdout is not None
            service.process.stdout.close()
        assert asyncio.run(look(url, acknowledged)) <= len(acknowledged) + (round_ + 1) * WRITERS
    assert acknowledged
    if url.startswith("sqlite"):
        with sqlite3.connect(url.removeprefix("sqlite:///")) as connection:
            assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        connection.close()
