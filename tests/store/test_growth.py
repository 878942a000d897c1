"""How fast the database grows is measured on the last day of its history."""

from __future__ import annotations

import pytest
from tests.store.examples import entry, observe, with_robots

from robomend.store import Store
from robomend.store.pruning import LEAST_DAYS, measure
from robomend.store.records import Retention

pytestmark = pytest.mark.anyio

HOUR_NS = 3_600_000_000_000
NOW_NS = 20_000 * 24 * HOUR_NS


def at(monkeypatch: pytest.MonkeyPatch, hours: float) -> None:
    monkeypatch.setattr("time.time_ns", lambda: NOW_NS + int(hours * HOUR_NS))


async def test_only_the_last_day_counts_and_each_robot_has_its_share(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    at(monkeypatch, -100)
    await with_robots(store, "r1", "r2", "r3")
    for robot in ("r1", "r2", "r3"):
        await observe(store, robot, entry("scan"))
    at(monkeypatch, -1)
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
    at(monkeypatch, -1)
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
    at(monkeypatch, -1000)
    await with_robots(store, "r1")
    await observe(store, "r1", entry("scan"))
    assert (await store.read(measure, NOW_NS)).bytes_a_day > 0


async def test_retention_ends_the_growth(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    at(monkeypatch, -1)
    await with_robots(store, "r1")
    await observe(store, "r1", entry("scan"))
    found = await store.read(measure, NOW_NS)
    assert found.logs.keys() == {"observations", "results"}
    for retention, days in ((Retention(2, 1, 1), 2), (Retention(2, 5, 3), 3)):  # at least as an event is
        assert found.kept(retention) == pytest.approx(days * found.bytes_a_day)
    assert found.kept(Retention(observations_days=None)) is None


async def test_of_an_empty_database_nothing_is_said(store: Store) -> None:
    assert (await store.read(measure, NOW_NS)).bytes_a_day == 0
