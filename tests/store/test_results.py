"""What diagnoses say is kept once for all that say the same, and comes back whole."""

from __future__ import annotations

import asyncio
import json

import pytest
from sqlalchemy import func, select
from tests.store.examples import with_robots

from robomend.store import Store, Transaction, View, diagnoses, events, schema
from robomend.store.encoding import Common, Encoded
from robomend.store.pruning import prune
from robomend.store.records import Retention
from robomend_client.events import Kind

pytestmark = pytest.mark.anyio

DAY_NS = 86_400_000_000_000
NOW_NS = 20_000 * DAY_NS
WEEK = Retention(7, 7, 7, 7, 7, 7)


def said(revision: int, bad: str) -> Encoded:
    """Return a diagnosis of which all but the revision and the time is common."""
    result = f'"fault":null,"result":{{"bad":"{bad}"'
    text = f'{{"revision":{revision},{result},"elapsed_s":0.5}}}}'
    return Encoded.around(json.loads(text), f'{{"revision":{revision},', Common(result), ',"elapsed_s":0.5}}')


async def announce(store: Store, robot: str, revision: int, bad: str) -> None:
    data = said(revision, bad)

    def change(tx: Transaction) -> None:
        diagnoses.record(tx, robot, revision, data)

    await store.write(change)


async def kept(store: Store) -> list[tuple[int, int]]:
    """Return number and last day of use of each result that is kept."""

    def look(view: View) -> list[tuple[int, int]]:
        table = schema.results
        return [(row.number, row.used_day) for row in view.rows(select(table).order_by(table.c.number))]

    return await store.read(look)


def at(monkeypatch: pytest.MonkeyPatch, day: float) -> None:
    monkeypatch.setattr("time.time_ns", lambda: NOW_NS + int(day * DAY_NS))


async def test_equal_results_are_kept_once_whoever_has_them_and_come_back_whole(
    store: Store, second: Store
) -> None:
    await with_robots(store, "r1", "r2")
    await announce(store, "r1", 1, "imu")
    await announce(second, "r2", 1, "imu")
    await announce(store, "r1", 2, "é: ∪\\n")
    await announce(second, "r1", 3, "imu")
    assert len(await kept(store)) == 2
    page = await store.read(diagnoses.page, "r1")
    assert [item.result for item in page.items] == [said(3, "imu"), said(2, "é: ∪\\n"), said(1, "imu")]
    assert (await store.read(diagnoses.latest, "r2")) is not None
    told = await store.read(events.after, 0)
    assert [dict(event.data) for event in told if event.kind is Kind.DIAGNOSIS] == [
        said(1, "imu"),
        said(1, "imu"),
        said(2, "é: ∪\\n"),
        said(3, "imu"),
    ]


async def test_a_row_of_its_own_is_small(store: Store) -> None:
    await with_robots(store, "r1")
    for revision in range(1, 21):
        await announce(store, "r1", revision, "a long text " * 200)

    def longest(view: View) -> int:
        return int(view.rows(select(func.max(func.length(schema.events.c.data))))[0][0])

    assert await store.read(longest) < 60


async def test_a_result_of_a_change_that_is_taken_back_is_still_written_for_the_next(store: Store) -> None:
    await with_robots(store, "r1")

    def half(tx: Transaction) -> None:
        diagnoses.record(tx, "r1", 1, said(1, "imu"))
        tx.rows(select(schema.results))  # puts what waits, and is in a savepoint from here on
        raise ValueError("taken back")

    def whole(tx: Transaction) -> None:
        diagnoses.record(tx, "r1", 2, said(2, "imu"))

    writes = [store.write(change, robots=("r1",)) for change in (whole, half, whole)]
    outcomes = await asyncio.gather(*writes, return_exceptions=True)
    assert [isinstance(outcome, ValueError) for outcome in outcomes] == [False, True, False]
    page = await store.read(diagnoses.page, "r1")
    assert [item.result for item in page.items] == [said(2, "imu")] * 2
    assert len(await kept(store)) == 1


async def test_what_no_row_has_any_more_goes_and_what_a_robot_has_now_stays(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    at(monkeypatch, -40)
    await with_robots(store, "r1", "r2")
    await announce(store, "r1", 1, "once")
    await announce(store, "r2", 1, "for ever")
    at(monkeypatch, -20)
    await announce(store, "r1", 2, "again")
    at(monkeypatch, -1)
    await announce(store, "r1", 3, "again")
    at(monkeypatch, 0)
    before = await kept(store)
    assert [day - 20_000 for _, day in before] == [-40, -40, -1]  # `again` was used again
    pruned = await prune(store, WEEK, slice=1)
    assert (pruned.diagnoses, pruned.results) == (2, 1)
    assert [number for number, _ in await kept(store)] == [before[1][0], before[2][0]]
    for robot, revision, bad in (("r1", 3, "again"), ("r2", 1, "for ever")):
        latest = await store.read(diagnoses.latest, robot)
        assert latest is not None
        assert latest.result == said(revision, bad)
    at(monkeypatch, 100)
    await prune(store, WEEK)
    latest = await store.read(diagnoses.latest, "r2")
    assert latest is not None
    assert latest.result == said(1, "for ever")


async def test_a_clock_that_goes_back_takes_no_result_from_a_row_that_stays(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    await with_robots(store, "r1")
    for day, bad in ((-30, "a"), (0, "b"), (-30, "a")):
        at(monkeypatch, day)
        await announce(store, "r1", 1, bad)
    at(monkeypatch, 1)
    await prune(store, WEEK)
    told = [event for event in await store.read(events.after, 0) if event.kind is Kind.DIAGNOSIS]
    assert [dict(event.data) for event in told] == [said(1, "b"), said(1, "a")]
