"""Several instances on one database: each serves any robot, and none undoes what another has done."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from functools import partial

import pytest
from sqlalchemy import exc
from tests.store.examples import entry, observe, with_robots

from robomend.errors import PreconditionRequired, StateConflict
from robomend.store import Store, Transaction, global_stop, observations, repairs, robots
from robomend.store.records import IdempotencyKey
from robomend.store.transaction import Group

pytestmark = pytest.mark.anyio


async def test_a_request_sent_to_two_instances_at_once_acts_once(store: Store, second: Store) -> None:
    await with_robots(store, "r1")

    def accept(tx: Transaction) -> int:
        return observations.observe(tx, "r1", accepted=[entry("scan")])

    async def send(who: Store, key: int) -> int:
        return await who.write(accept, robots=("r1",), once=IdempotencyKey("ada", str(key), "digest"))

    answers = await asyncio.gather(*(send(who, key) for key in range(50) for who in (store, second)))
    assert answers[::2] == answers[1::2]
    assert sorted(answers[::2]) == list(range(1, 51))
    assert await store.read(observations.revision, "r1") == 50


async def test_instances_that_write_many_robots_in_any_order_do_not_block_each_other(
    store: Store, second: Store
) -> None:
    robots = [f"r{number}" for number in range(10)]
    await with_robots(store, *robots)

    def all_of_them(order: list[str]) -> asyncio.Future[int]:
        def change(tx: Transaction) -> int:
            return sum(observations.observe(tx, robot, changed=[entry("scan")]) for robot in order)

        who = store if order is robots else second
        return asyncio.ensure_future(who.write(change, robots=order))

    backwards = robots[::-1]
    await asyncio.gather(*(all_of_them(order) for _ in range(40) for order in (robots, backwards)))
    assert await store.read(lambda db: [observations.revision(db, robot) for robot in robots]) == [80] * 10


async def test_of_two_instances_that_create_the_same_one_is_told(store: Store, second: Store) -> None:
    results = await asyncio.gather(
        *(
            who.write(partial(robots.put, robot="r1", config={"policy": policy}, expected=None))
            for who, policy in ((store, "auto"), (second, "observe"))
        ),
        return_exceptions=True,
    )
    (made,) = [result for result in results if not isinstance(result, BaseException)]
    assert any(isinstance(result, (PreconditionRequired, StateConflict)) for result in results)
    assert (await second.read(robots.get, "r1")).config == made.config


async def test_an_instance_that_works_on_an_older_obs_is_told(store: Store, second: Store) -> None:
    await with_robots(store, "r1")
    calls = [observe(who, "r1", entry("scan"), expected=0) for who in (store, second)]
    results = await asyncio.gather(*calls, return_exceptions=True)
    assert 1 in results
    assert [type(result) for result in results].count(StateConflict) == 1


async def test_a_group_that_met_a_deadlock_is_repeated(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """Results are those of the repetition, also where the first try ended otherwise."""
    await with_robots(store, "r1")
    finish = Group.finish
    tries = 0

    class Deadlock(Exception):
        sqlstate = "40P01"

    def finish_at_second(group: Group) -> object:
        nonlocal tries
        tries += 1
        if tries == 1:
            raise exc.OperationalError("COMMIT", {}, Deadlock("deadlock detected"))
        return finish(group)

    monkeypatch.setattr(Group, "finish", finish_at_second)

    def fails_first(tx: Transaction) -> int:
        if tries == 0:
            raise ZeroDivisionError
        return observations.observe(tx, "r1")

    assert await store.write(fails_first) == 1
    assert tries == 2


# --- an intent comes wholly before a stop or a cancellation, or sees it, whichever instance writes which

OVERTAKES_S = 1.0
"""How long the first stays in the middle of its write: what may overtake it does so by then."""


async def overtaken(
    first: Store, second: Store, looks: Callable[[Transaction], object], says: Callable[[Transaction], object]
) -> bool:
    """Return whether `says` was committed by the second store while `looks` was under way in the first."""
    looked, said, late = threading.Event(), threading.Event(), threading.Event()

    def look(tx: Transaction) -> None:
        assert not looks(tx)
        looked.set()
        if said.wait(OVERTAKES_S):
            late.set()

    looking = asyncio.ensure_future(first.write(look, robots=("r1",)))
    await asyncio.to_thread(looked.wait)
    await second.write(says)
    said.set()
    await looking
    return late.is_set()


async def test_a_stop_waits_for_those_who_have_read_that_there_is_none(store: Store, second: Store) -> None:
    await with_robots(store, "r1")
    assert not await overtaken(
        store,
        second,
        lambda tx: global_stop.hold(tx).active,
        lambda tx: global_stop.put(tx, True, by="ann", reason="people on the floor"),
    )
    assert await store.write(lambda tx: global_stop.hold(tx).active)


async def test_a_cancellation_waits_for_an_intent_that_is_being_written(store: Store, second: Store) -> None:
    await with_robots(store, "r1")
    repair = await store.write(lambda tx: repairs.create(tx, "r1", state="running", data={}))
    assert not await overtaken(
        store,
        second,
        lambda tx: repairs.requests(tx, "r1"),
        lambda tx: repairs.ask(tx, repair.id, "cancel", by="ann", reason="I see smoke"),
    )
    assert [r.what for r in await store.write(lambda tx: repairs.requests(tx, "r1"))] == ["cancel"]
