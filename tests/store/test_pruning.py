"""Retention removes what is old, in slices, and keeps what is current."""

from __future__ import annotations

import asyncio
import time
from dataclasses import replace

import pytest
from tests.store.examples import entry, intents, observe, with_robots

from robomend.store import Store, Transaction, diagnoses, events, journal, observations, repairs
from robomend.store.pruning import LEAST_DAYS, measure, prune
from robomend.store.records import AuditEntry, EventRange, IdempotencyKey, Paging, Pruned, Retention
from robomend_client.events import Kind

pytestmark = pytest.mark.anyio

DAY_NS = 86_400_000_000_000
EVERYTHING = Retention(1, 1, 1, 1, 1, 1, 1)


def at(monkeypatch: pytest.MonkeyPatch, days_ago: float) -> None:
    moment = REAL_NOW - int(days_ago * DAY_NS)
    monkeypatch.setattr("time.time_ns", lambda: moment)


REAL_NOW = time.time_ns()


async def test_what_is_old_goes_and_what_is_young_stays(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    await with_robots(store, "r1")
    for days_ago in (5, 4, 3, 0):
        at(monkeypatch, days_ago)
        revision = await observe(store, "r1", entry("scan"))

        def rest(tx: Transaction, revision: int = revision) -> None:
            diagnoses.record(tx, "r1", revision, {})
            tx.note(AuditEntry("ada", "x", "r1"))

        await store.write(rest)
    pruned = await prune(store, EVERYTHING, slice=2)
    assert (pruned.observations, pruned.events, pruned.diagnoses, pruned.audit) == (3, 0, 3, 3)
    assert [b.revision for b in (await store.read(observations.history, "r1")).items] == [4]
    assert await store.read(events.kept) == EventRange(7, 8)
    assert len((await store.read(observations.obs, "r1")).entries) == 1
    assert await prune(store, EVERYTHING) == Pruned()


async def test_the_latest_diagnosis_and_open_repairs_stay_however_old(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    at(monkeypatch, 10)
    await with_robots(store, "r1")
    fence = await store.ownership.acquire("r1")
    assert fence is not None

    def old(tx: Transaction) -> tuple[str, str]:
        diagnoses.record(tx, "r1", 1, {})
        diagnoses.record(tx, "r1", 2, {})
        running = repairs.create(tx, "r1", state="running", data={}, fence=fence).id
        ended = repairs.create(tx, "r1", state="failed", data={}, open=False, fence=fence).id
        for repair in (running, ended):
            journal.intend(
                tx, repair, 0, action=f"{repair}:0", name="n", parameters=[], timeout_s=1, fence=fence
            )
        return running, ended

    running, ended = await store.write(old)
    at(monkeypatch, 0)
    pruned = await prune(store, EVERYTHING)
    assert (pruned.diagnoses, pruned.repairs) == (1, 1)
    assert [r.id for r in (await store.read(repairs.page)).items] == [running]
    assert len(await store.read(intents, running)) == 1
    assert await store.read(intents, ended) == ()


async def test_a_log_is_cut_from_its_beginning_only(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """After the clock jumped back, an entry that looks old lies behind a young one, and stays."""
    await with_robots(store, "r1")
    for days_ago in (5, 0, 3, 0):
        at(monkeypatch, days_ago)
        await observe(store, "r1", entry("scan"))
    assert (await prune(store, EVERYTHING)).observations == 1
    assert await store.read(events.kept) == EventRange(2, 4)


async def test_obs_outlives_the_batches_that_made_it(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    at(monkeypatch, 5)
    await with_robots(store, "r1", "r2")
    for name in ("scan", "odom", "map"):
        await observe(store, "r1", entry(name))
    await observe(store, "r2", entry("scan"))
    at(monkeypatch, 0)
    await observe(store, "r2", entry("odom"))
    before = await store.read(lambda db: [observations.obs(db, robot) for robot in ("r1", "r2")])
    assert (await prune(store, EVERYTHING)).observations == 4
    assert before == await store.read(lambda db: [observations.obs(db, robot) for robot in ("r1", "r2")])
    assert await observe(store, "r1", entry("late")) == 4
    assert await store.read(events.kept) == EventRange(5, 6)


async def test_an_id_is_not_given_twice_though_its_row_is_gone(store: Store, second: Store) -> None:
    await with_robots(store, "r1")
    await observe(store, "r1", entry("scan"))
    await store.write(lambda tx: tx.emit(Kind.ROBOT, "r1", {}))
    await prune(store, replace(EVERYTHING, events_days=-1, observations_days=-1))
    assert await store.read(events.kept) == EventRange(3, 2)
    assert await store.read(events.after, 0) == ()
    await observe(second, "r1", entry("odom"))
    assert [event.id for event in await store.read(events.after, 0)] == [3]


async def test_a_history_may_be_longer_than_the_log_of_events(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    await with_robots(store, "r1")
    for days_ago in (5, 3, 0):
        at(monkeypatch, days_ago)

        def change(tx: Transaction) -> None:
            revision = observations.observe(tx, "r1", accepted=[entry("scan")], changed=[entry("scan")])
            diagnoses.record(tx, "r1", revision, {"revision": revision})
            tx.emit(Kind.ROBOT, "r1", {})

        await store.write(change)
    pruned = await prune(store, replace(EVERYTHING, events_days=1, observations_days=4, diagnoses_days=2))
    assert (pruned.observations, pruned.diagnoses, pruned.events) == (1, 0, 2)
    assert await store.read(events.kept) == EventRange(7, 9)
    assert [event.id for event in await store.read(events.after, 0)] == [7, 8, 9]
    assert [event.id for event in await store.read(events.after, 0, robot="r1")] == [7, 8, 9]
    assert [batch.revision for batch in (await store.read(observations.history, "r1")).items] == [3, 2]
    assert [one.revision for one in (await store.read(diagnoses.page, "r1")).items] == [3, 2]


async def test_what_was_the_latest_diagnosis_goes_once_it_is_not(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    await with_robots(store, "r1")

    async def diagnose(days_ago: float, revision: int) -> None:
        at(monkeypatch, days_ago)
        await store.write(lambda tx: diagnoses.record(tx, "r1", revision, {}))
        await store.write(lambda tx: tx.emit(Kind.ROBOT, None, {}))  # something behind it

    async def pruned(days_ago: float) -> list[int]:
        at(monkeypatch, days_ago)
        await prune(store, EVERYTHING)
        return [one.revision for one in (await store.read(diagnoses.page, "r1", Paging(limit=9))).items]

    await diagnose(9, 1)
    assert await pruned(7) == [1]
    await diagnose(6.5, 2)
    assert await pruned(6) == [2, 1]  # which nothing looks for before the next of the robot is old
    await diagnose(4, 3)
    assert await pruned(2.5) == [3]


async def test_expired_idempotency_keys_go(store: Store) -> None:
    for number in range(5):
        await store.write(lambda tx: 1, once=IdempotencyKey("ada", f"k{number}", "x", ttl_s=0))
    await store.write(lambda tx: 1, once=IdempotencyKey("ada", "kept", "x"))
    assert (await prune(store, Retention(), slice=2)).idempotency == 5


async def test_others_write_between_the_slices(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    await with_robots(store, "r1")
    at(monkeypatch, 5)
    await asyncio.gather(*(observe(store, "r1", entry("scan")) for _ in range(60)))
    at(monkeypatch, 0)
    pruning = asyncio.create_task(prune(store, EVERYTHING, slice=1))
    revisions = [await observe(store, "r1", entry("scan")) for _ in range(3)]
    assert not pruning.done()
    assert revisions == [61, 62, 63]
    assert (await pruning).observations == 60


# --- how fast the database grows is measured on the last day of its history

HOUR_NS = 3_600_000_000_000
NOW_NS = 20_000 * 24 * HOUR_NS


def at_hour(monkeypatch: pytest.MonkeyPatch, hours: float) -> None:
    monkeypatch.setattr("time.time_ns", lambda: NOW_NS + int(hours * HOUR_NS))


async def test_only_the_last_day_counts_and_each_robot_has_its_share(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_hour(monkeypatch, -100)
    await with_robots(store, "r1", "r2", "r3")
    for robot in ("r1", "r2", "r3"):
        await observe(store, robot, entry("scan"))
    at_hour(monkeypatch, -1)
    for robot in ("r1", "r2", "r2", "r2"):
        await observe(store, robot, entry("scan"))
    found = await store.read(measure, NOW_NS)
    assert found.days == 1.0
    assert found.robots.keys() == {"r1", "r2"}
    assert found.robots["r2"] == pytest.approx(3 * found.robots["r1"], rel=0.05)
    assert sum(found.robots.values()) == pytest.approx(found.bytes_a_day)


async def test_a_history_of_an_hour_is_taken_for_24_times_as_much(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_hour(monkeypatch, -1)
    await with_robots(store, "r1")
    await observe(store, "r1", entry("scan"))
    hour = await store.read(measure, NOW_NS)
    minutes = await store.read(measure, NOW_NS - HOUR_NS + 1)
    assert hour.days == pytest.approx(1 / 24)
    assert minutes.days == LEAST_DAYS  # and not from a nanosecond to a day
    assert minutes.bytes_a_day == pytest.approx(6 * hour.bytes_a_day)


async def test_a_history_that_ended_long_ago_tells_of_its_last_day(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_hour(monkeypatch, -1000)
    await with_robots(store, "r1")
    await observe(store, "r1", entry("scan"))
    assert (await store.read(measure, NOW_NS)).bytes_a_day > 0


async def test_retention_ends_the_growth(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    at_hour(monkeypatch, -1)
    await with_robots(store, "r1")
    await observe(store, "r1", entry("scan"))
    found = await store.read(measure, NOW_NS)
    assert found.logs.keys() == {"observations", "results"}
    for retention, days in ((Retention(2, 1, 1), 2), (Retention(2, 5, 3), 3)):  # at least as an event is
        assert found.kept(retention) == pytest.approx(days * found.bytes_a_day)
    assert found.kept(Retention(observations_days=None)) is None


async def test_of_an_empty_database_nothing_is_said(store: Store) -> None:
    assert (await store.read(measure, NOW_NS)).bytes_a_day == 0
