"""What a writer goes by is what is there, whoever wrote or removed it last."""

from __future__ import annotations

from functools import partial

import pytest
from tests.store.examples import entry, observe, with_robots
from tests.store.test_results import announce, kept

from robomend.errors import StateConflict
from robomend.store import Store, Transaction, diagnoses, observations, schema
from robomend.store.pruning import _remove_unused

pytestmark = pytest.mark.anyio

UNUSED_SINCE = 10**6
"""A day that is far away: whatever was used before it is removed."""


async def test_what_another_instance_wrote_is_seen_at_once(store: Store, second: Store) -> None:
    await with_robots(store, "r1")
    for revision in (1, 2):
        await observe(store, "r1", entry("scan", revision == 1))
    await observe(second, "r1", entry("scan"))

    def late(tx: Transaction) -> int:
        return observations.observe(tx, "r1", changed=[entry("scan")], expected=2)

    with pytest.raises(StateConflict, match="revision 3"):
        await store.write(late, robots=["r1"])
    await observe(store, "r1", entry("odom"))
    assert await second.read(observations.revision, "r1") == 4


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


async def test_nothing_is_known_of_a_change_that_failed(store: Store) -> None:
    await with_robots(store, "r1")
    await observe(store, "r1", entry("scan"))

    def fail(tx: Transaction) -> None:
        observations.observe(tx, "r1", changed=[entry("odom")])
        raise StateConflict("not this one")

    with pytest.raises(StateConflict, match="not this one"):
        await store.write(fail, robots=["r1"])
    await observe(store, "r1", entry("scan", False))
    assert await store.read(observations.revision, "r1") == 2


async def test_a_robot_that_is_deleted_is_not_known_any_more(store: Store) -> None:
    await with_robots(store, "r1")
    await observe(store, "r1", entry("scan"))
    gone = schema.robots.delete().where(schema.robots.c.id == "r1")
    await store.write(lambda tx: tx.change(gone))
    with pytest.raises(Exception, match="no robot 'r1'"):
        await observe(store, "r1", entry("scan"))
    kept = await store.read(observations.history, "r1")
    assert [batch.revision for batch in kept.items] == [1]
