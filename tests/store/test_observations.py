"""OBS, history, diagnoses, and what a group of changes shares."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import replace

import pytest
from sqlalchemy import select
from tests.store.examples import entry, observe, with_robots

from robomend.errors import InputError, NotFound, StateConflict
from robomend.store import Store, Transaction, View, audit, diagnoses, events, observations, robots, schema
from robomend.store.records import AuditEntry, IdempotencyKey, Paging, StoredAssertion, StoredBatch
from robomend_client.events import Kind
from robomend_client.literals import Atom, Literal

pytestmark = pytest.mark.anyio


async def test_an_atom_comes_back_whatever_its_names_hold(store: Store) -> None:
    await with_robots(store, "r1")
    odd = [Atom("ok", ('a "quoted", name', "b\\c")), Atom("p"), Atom("ok", ("",)), Atom("ok", ("NUL \x00",))]
    entries = [replace(entry("x"), literal=Literal(atom)) for atom in odd]
    await observe(store, "r1", *entries)
    obs = await store.read(observations.obs, "r1")
    assert {e.atom for e in obs.entries} == set(odd)
    history = await store.read(observations.history, "r1")
    assert history.items[0].entries == tuple(entries)


async def test_history_is_newest_first_and_in_order_of_revision_when_the_clock_jumps_back(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    await with_robots(store, "r1")
    for now_ns in (3_000, 1_000, 2_000):
        monkeypatch.setattr("time.time_ns", lambda now_ns=now_ns: now_ns)
        await observe(store, "r1", entry("scan", time_ns=now_ns))
    first = await store.read(observations.history, "r1", Paging(limit=2))
    rest = await store.read(observations.history, "r1", Paging(first.next))
    batches: list[StoredBatch] = [*first.items, *rest.items]
    assert [(b.revision, b.time_ns) for b in batches] == [(3, 2_000), (2, 1_000), (1, 3_000)]
    log = await store.read(events.after, 0)
    assert [event.time_ns for event in log] == [3_000, 1_000, 2_000]


async def test_concurrent_batches_get_each_their_revision(store: Store) -> None:
    robots = [f"r{number}" for number in range(5)]
    await with_robots(store, *robots)
    calls = [observe(store, robots[n % 5], entry(f"t{n % 7}", time_ns=n)) for n in range(400)]
    revisions = await asyncio.gather(*calls)
    assert sorted(revisions) == sorted(n // 5 + 1 for n in range(400))
    log = await store.read(events.after, 0, limit=1000)
    assert [event.id for event in log] == list(range(1, 401))
    assert (store.figures().commits) < 200  # many share one transaction


async def test_a_change_that_fails_takes_nobody_with_it_and_leaves_nothing(store: Store) -> None:
    """Failures of every kind, in one group with changes that go well."""
    await with_robots(store, "r1")

    def raises_late(tx: Transaction) -> None:
        observations.observe(tx, "r1", accepted=[entry("bad")], changed=[entry("bad")])
        robots.put(tx, "half", {}, expected=None)
        tx.emit(Kind.ROBOT, "half", {"change": "created"})
        tx.note(AuditEntry("ada", "robot.put", "half"))
        raise ZeroDivisionError

    def no_such_robot(tx: Transaction) -> None:
        observations.observe(tx, "nobody")

    def too_large(tx: Transaction) -> None:
        observations.observe(tx, "r1", changed=[entry("bad", time_ns=2**63)])

    def bad_text(tx: Transaction) -> None:
        observations.observe(tx, "r1", changed=[entry("bad", source="\x00")])

    def good(tx: Transaction) -> int:
        return observations.observe(tx, "r1", changed=[entry("good")])

    def created_and_used(tx: Transaction) -> int:
        robots.put(tx, "r9", {}, expected=None)
        observations.observe(tx, "r9", changed=[entry("good")])
        return observations.revision(tx, "r9")

    changes = [good, raises_late, no_such_robot, good, too_large, bad_text, created_and_used, good]
    results = await asyncio.gather(*(store.write(c) for c in changes), return_exceptions=True)
    assert [r if isinstance(r, int) else type(r) for r in results] == [
        1,
        ZeroDivisionError,
        NotFound,
        2,
        InputError,
        InputError,
        1,
        3,
    ]
    obs = await store.read(observations.obs, "r1")
    assert [e.atom.args for e in obs.entries] == [("good",)]
    assert [event.kind for event in await store.read(events.after, 0)] == [Kind.OBSERVATIONS] * 4
    assert (await store.read(audit.page)).items == ()
    with pytest.raises(NotFound):
        await store.read(robots.get, "half")


async def test_a_row_that_the_database_refuses_fails_alone(store: Store) -> None:
    """The culprit is found although the whole group was refused at its end."""
    await with_robots(store, "r1", "r2")

    def culprit(tx: Transaction) -> None:
        observations.observe(tx, "r2", changed=[entry("x", source=object())])  # type: ignore[arg-type]  # on purpose

    def sneaky(tx: Transaction) -> None:
        diagnoses.record(tx, "r2", 1, {})
        tx.waiting.log[-1].revision = object()  # type: ignore[assignment]  # no method lets this pass

    good = [observe(store, "r1", entry("a")), observe(store, "r1")]
    calls = [good[0], store.write(culprit), store.write(sneaky), good[1]]
    results = await asyncio.gather(*calls, return_exceptions=True)
    assert (results[0], results[3]) == (1, 2)
    assert all(isinstance(results[n], Exception) for n in (1, 2))
    assert await observe(store, "r2", entry("b")) == 1


async def test_a_repeated_request_acts_once_and_gets_the_first_answer(store: Store) -> None:
    await with_robots(store, "r1")
    once = IdempotencyKey("ada POST /robots/r1/observations", "key-1", "digest")

    def accept(tx: Transaction) -> Mapping[str, int]:
        return {"revision": observations.observe(tx, "r1", changed=[entry("scan")])}

    calls = [store.write(accept, robots=("r1",), once=once) for _ in range(5)]
    assert await asyncio.gather(*calls) == [{"revision": 1}] * 5
    assert await store.write(accept, robots=("r1",), once=once) == {"revision": 1}
    with pytest.raises(StateConflict) as refused:
        await store.write(accept, once=IdempotencyKey(once.scope, once.key, "another digest"))
    assert refused.value.code == "idempotency-key-reused"
    other_scope = IdempotencyKey("bob", once.key, "digest")
    assert await store.write(accept, once=other_scope) == {"revision": 2}


async def test_a_key_is_free_again_after_its_time_and_after_a_failure(store: Store) -> None:
    await with_robots(store, "r1")
    short = IdempotencyKey("ada", "k", "one", ttl_s=0)
    assert await store.write(lambda tx: observations.observe(tx, "r1"), once=short) == 1
    assert (
        await store.write(lambda tx: observations.observe(tx, "r1"), once=IdempotencyKey("ada", "k", "two"))
        == 2
    )
    failing = IdempotencyKey("ada", "f", "one")
    with pytest.raises(NotFound):
        await store.write(lambda tx: observations.observe(tx, "nobody"), once=failing)
    assert await store.write(lambda tx: observations.observe(tx, "r1"), once=failing) == 3


async def test_an_answer_that_is_no_json_is_refused_whole(store: Store) -> None:
    await with_robots(store, "r1")

    def accept(tx: Transaction) -> object:
        observations.observe(tx, "r1")
        return object()

    with pytest.raises(InputError):
        await store.write(accept, once=IdempotencyKey("ada", "k", "one"))
    assert await store.read(observations.revision, "r1") == 0


async def test_a_change_sees_its_own_writes_and_those_before_it_in_the_group(store: Store) -> None:
    await with_robots(store, "r1")

    def write_then_read(tx: Transaction) -> tuple[int, int, int]:
        night = StoredAssertion("night", "ok(scan)", "ada", 5)
        revision = observations.observe(tx, "r1", accepted=[entry("a")], asserted=[night])
        kept = tx.rows(select(schema.assertions))
        return revision, observations.revision(tx, "r1"), len(kept)

    calls = [observe(store, "r1", entry("b")), store.write(write_then_read), observe(store, "r1", entry("c"))]
    assert await asyncio.gather(*calls) == [1, (2, 2, 1), 3]


@pytest.mark.parametrize("read", [observations.obs, observations.history, diagnoses.page, robots.newest])
async def test_a_change_is_not_told_of_a_log_that_lacks_what_it_wrote(
    store: Store, read: Callable[[View, str], object]
) -> None:
    await with_robots(store, "r1")
    with pytest.raises(RuntimeError, match="written at the end of a group"):
        await store.write(lambda tx: read(tx, "r1"))


async def test_a_cancelled_caller_takes_nothing_back(store: Store) -> None:
    await with_robots(store, "r1")
    task = asyncio.create_task(observe(store, "r1", entry("scan")))
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert await observe(store, "r1", entry("odom")) == 2
