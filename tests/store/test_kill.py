"""kill -9 at random moments under load: nothing acknowledged is lost, nothing half there, nothing corrupt."""

from __future__ import annotations

import asyncio
import random
import sqlite3
import threading

import pytest
from tests.store.instance import ROBOTS, WRITERS, instance, next_line

from robomend.store import Store, View, events, observations
from robomend.store.records import Paging, StoredBatch


def kill_under_load(url: str, after_s: float, *, at_work: bool) -> list[tuple[str, str]]:
    """Return the (robot, marker) pairs that were acknowledged before the process was killed.

    Its time counts from where it is ready, or, `at_work`, from its first acknowledgement.
    """
    with instance(url, "write") as process:
        assert next_line(process) == "ready"
        first = f"{next_line(process)}\n" if at_work else ""
        timer = threading.Timer(after_s, process.kill)
        timer.start()
        try:
            assert process.stdout is not None
            lines = (first + process.stdout.read().decode()).splitlines(keepends=True)
        finally:
            timer.cancel()
            timer.join()
    pairs = [line.split() for line in lines if line.endswith("\n")]
    return [(robot, marker) for robot, marker in pairs]


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


def check_all(db: View, acknowledged: list[tuple[str, str]]) -> int:
    """Check that all of it is there, once, and that history, OBS and events agree; return the batches."""
    markers: list[str] = []
    for robot in ROBOTS:
        batches = whole_history(db, robot)
        obs = observations.obs(db, robot)
        assert [batch.revision for batch in batches] == list(range(1, obs.revision + 1))
        mine = [batch.entries[0].atom.args[0] for batch in batches]
        assert [kept.source for kept in obs.entries] == mine[-1:]
        markers += mine
    assert len(set(markers)) == len(markers)
    assert {marker for _, marker in acknowledged} <= set(markers)
    assert events.kept(db).newest == len(markers)
    return len(markers)


async def check(url: str, acknowledged: list[tuple[str, str]]) -> int:
    """Look into the store as the next process would."""
    store = Store(url)
    await store.start()
    try:
        return await store.read(lambda db: check_all(db, acknowledged))
    finally:
        await store.close()


@pytest.mark.timeout(1800)
def test_nothing_acknowledged_is_lost_when_the_process_is_killed(url: str, long: bool) -> None:
    rounds, chance = (200 if long else 5), random.Random(7)
    acknowledged: list[tuple[str, str]] = []
    for number in range(rounds):
        acknowledged += kill_under_load(url, chance.uniform(0.0, 0.4), at_work=number % 2 == 0)
    total = asyncio.run(check(url, acknowledged))
    assert len(acknowledged) > 0
    assert total <= len(acknowledged) + rounds * WRITERS  # kept, but killed before it could say so
    if url.startswith("sqlite"):
        with sqlite3.connect(url.removeprefix("sqlite:///")) as connection:
            assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        connection.close()
