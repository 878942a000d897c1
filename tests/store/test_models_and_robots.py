"""Models with versions, robots with configurations: conditional updates, lists, what refers to what."""

from __future__ import annotations

import pytest
from tests.store.examples import with_robots

from robomend.errors import (
    InputError,
    NotFound,
)
from robomend.store import Store, Transaction, models, observations, robots
from robomend.store.records import Paging, StoredModel, StoredRobot

pytestmark = pytest.mark.anyio


async def put_model(store: Store, source: str, expected: str | None, name: str = "tedusar") -> StoredModel:
    return await store.write(
        lambda tx: models.put(tx, name, source, format="component", by="ada", expected=expected)
    )


async def put_robot(store: Store, robot: str, config: dict[str, object], expected: str | None) -> StoredRobot:
    return await store.write(lambda tx: robots.put(tx, robot, config, expected=expected))


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
