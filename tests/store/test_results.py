"""What diagnoses say is kept once for all that say the same, and comes back whole."""

from __future__ import annotations

import asyncio
import json
from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import select
from tests.store.examples import with_robots

from robomend.store import Store, Transaction, View, diagnoses, events, schema
from robomend.store.encoding import Common, Encoded, from_json, to_json
from robomend.store.pruning import _remove_unused, prune
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


UNUSED_SINCE = 10**6
"""A day that is far away: whatever was used before it is removed."""


@pytest.mark.parametrize("ours", [True, False])
async def test_a_result_that_was_removed_is_kept_anew(store: Store, second: Store, ours: bool) -> None:
    await with_robots(store, "r1")
    await announce(store, "r1", 1, "jaguar")
    await announce(store, "r1", 2, "jaguar")
    numbers = [number for number, _ in await kept(store)]
    for revision in (3, 4):  # the first time it is counted, and again
        await (store if ours else second).write(partial(_remove_unused, UNUSED_SINCE, keys=numbers))
        await announce(store, "r1", revision, "jaguar")
        [(number, _)] = await kept(store)
        assert number not in numbers
        numbers = [number]
    latest = await store.read(diagnoses.latest, "r1")
    assert latest is not None
    assert latest.result["result"]["bad"] == "jaguar"


async def test_in_a_group_a_result_that_is_removed_before_it_is_used_is_kept_anew(store: Store) -> None:
    await with_robots(store, "r1")
    await announce(store, "r1", 1, "jaguar")
    await announce(store, "r1", 2, "jaguar")
    remove = store.write(lambda tx: tx.change(schema.results.delete()))
    use = announce(store, "r1", 3, "jaguar")
    await remove
    await use
    latest = await store.read(diagnoses.latest, "r1")
    assert latest is not None
    assert latest.result["result"]["bad"] == "jaguar"


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=10,
)


@given(st.dictionaries(st.text(), VALUES, max_size=4))
def test_an_encoded_object_is_the_object(value: dict[str, object]) -> None:
    encoded = Encoded(value)
    assert encoded == value
    assert to_json(encoded) == to_json(value)
    assert from_json(to_json(encoded)) == value
    assert json.loads(json.dumps({"inside": encoded})) == {"inside": value}


def test_a_text_that_was_made_elsewhere_is_taken_as_it_is() -> None:
    assert to_json(Encoded({"a": 1}, '{"a":1}')) == '{"a":1}'
