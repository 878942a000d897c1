"""Models with versions, robots with configurations: conditional updates, lists, what refers to what."""

from __future__ import annotations

from functools import partial

import pytest
from tests.store.examples import with_robots

from robomend.errors import (
    InputError,
    NotFound,
    PreconditionFailed,
    PreconditionRequired,
    StateConflict,
)
from robomend.store import Store, Transaction, View, models, observations, robots
from robomend.store.records import ANY, Page, Paging, StoredModel, StoredRobot

pytestmark = pytest.mark.anyio


async def put_model(store: Store, source: str, expected: str | None, name: str = "tedusar") -> StoredModel:
    return await store.write(
        lambda tx: models.put(tx, name, source, format="component", by="ada", expected=expected)
    )


async def put_robot(store: Store, robot: str, config: dict[str, object], expected: str | None) -> StoredRobot:
    return await store.write(lambda tx: robots.put(tx, robot, config, expected=expected))


async def test_a_model_comes_back_as_it_was_put(store: Store) -> None:
    put = await put_model(store, "robomend: 1\nname: é\n", None)
    got = await store.read(models.get, "tedusar")
    assert got == put
    assert (got.number, got.by, got.source) == (1, "ada", "robomend: 1\nname: é\n")


async def test_replacing_a_model_needs_the_version_that_was_seen(store: Store) -> None:
    first = await put_model(store, "one", None)
    with pytest.raises(PreconditionRequired):
        await put_model(store, "two", None)
    with pytest.raises(PreconditionFailed):
        await put_model(store, "two", "another")
    second = await put_model(store, "two", first.version)
    with pytest.raises(PreconditionFailed):
        await put_model(store, "three", first.version)
    assert (await put_model(store, "three", ANY)).number == second.number + 1
    with pytest.raises(PreconditionFailed):
        await put_model(store, "one", ANY, name="not-there")


async def test_versions_are_kept_newest_first_and_the_same_text_adds_none(store: Store) -> None:
    one = await put_model(store, "one", None)
    two = await put_model(store, "two", one.version)
    assert await put_model(store, "two", two.version) == two
    again = await put_model(store, "one", two.version)
    assert (again.version, again.number) == (one.version, 3)
    versions = await store.read(models.versions, "tedusar")
    assert [version.number for version in versions.items] == [3, 2, 1]
    assert (await store.read(models.get, "tedusar", two.version)).source == "two"
    with pytest.raises(NotFound):
        await store.read(models.get, "tedusar", "0" * 20)


async def test_a_model_that_a_robot_follows_is_not_deleted(store: Store) -> None:
    await with_robots(store, "r1")
    with pytest.raises(StateConflict, match="r1"):
        await store.write(lambda tx: models.delete(tx, "tedusar"))
    await store.write(lambda tx: robots.delete(tx, "r1"))
    await store.write(lambda tx: models.delete(tx, "tedusar"))
    with pytest.raises(NotFound):
        await store.read(models.get, "tedusar")
    assert (await put_model(store, "new", None)).number == 1


async def test_a_robot_follows_a_model_that_is_there(store: Store) -> None:
    with pytest.raises(NotFound, match="nowhere"):
        await put_robot(store, "r1", {"model": "nowhere"}, None)
    with pytest.raises(InputError):
        await put_robot(store, "r1", {"model": 7}, None)
    assert (await store.read(robots.page)).items == ()


async def test_a_robots_etag_is_that_of_its_configuration_whatever_the_order_of_keys(store: Store) -> None:
    one = await put_robot(store, "r1", {"policy": "auto", "limits": {"per_hour": 3}}, None)
    assert await store.read(robots.get, "r1") == one
    same = await put_robot(store, "r1", {"limits": {"per_hour": 3}, "policy": "auto"}, one.etag)
    assert same.etag == one.etag
    other = await put_robot(store, "r1", {"policy": "observe"}, one.etag)
    with pytest.raises(PreconditionFailed):
        await put_robot(store, "r1", {"policy": "auto"}, one.etag)
    assert other.created_ns == one.created_ns


def robots_of_tedusar(paging: Paging, db: View) -> Page[StoredRobot]:
    return robots.page(db, paging, model="tedusar")


async def test_lists_come_in_pages_that_neither_repeat_nor_leave_out(store: Store) -> None:
    names = [f"robot-{number:02}" for number in range(25)] + ["Zoë", "_", "a b"]
    await with_robots(store, *names)
    seen: list[str] = []
    paging = Paging(limit=7)
    while True:
        page = await store.read(partial(robots_of_tedusar, paging))
        seen += [robot.id for robot in page.items]
        if page.next is None:
            break
        paging = Paging(page.next, 7)
    assert seen == sorted(names)


@pytest.mark.parametrize(
    "paging", [Paging(limit=0), Paging(limit=1001), Paging(cursor="x"), Paging("9" * 30)]
)
async def test_a_page_that_cannot_be_is_the_callers_fault(store: Store, paging: Paging) -> None:
    await with_robots(store, "r1")
    with pytest.raises(InputError):
        await store.read(observations.history, "r1", paging)


@pytest.mark.parametrize("name", ["a\x00b", "\ud800"])
async def test_a_name_that_no_column_takes_is_the_callers_fault(store: Store, name: str) -> None:
    with pytest.raises(InputError):
        await put_robot(store, name, {}, None)
    with pytest.raises(InputError):
        await store.read(robots.get, name)
    with pytest.raises(InputError):
        await store.write(lambda tx: None, robots=(name,))


async def test_a_configuration_may_hold_any_json(store: Store) -> None:
    config = {"note": "NUL \x00, half \ud800, ∪", "deep": [[[{"x": None}]]], "n": 10**30, "f": 0.1}
    await put_robot(store, "r1", config, None)
    assert (await store.read(robots.get, "r1")).config == config
    with pytest.raises(InputError):
        await put_robot(store, "r2", {"n": float("nan")}, None)


async def test_a_robot_created_again_goes_on_with_its_revision(store: Store) -> None:
    await with_robots(store, "r1")

    def observe_once(tx: Transaction) -> int:
        return observations.observe(tx, "r1")

    assert await store.write(observe_once) == 1
    await store.write(lambda tx: robots.delete(tx, "r1"))
    with pytest.raises(NotFound):
        await store.write(observe_once)
    await with_robots(store, "r1")
    assert await store.write(observe_once) == 2
