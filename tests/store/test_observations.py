"""OBS, history, configurations, and what a group of changes shares."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest
from tests.store.examples import entry, observe, with_robots

from robomend.errors import InputError, NotFound
from robomend.store import Store, Transaction, audit, diagnoses, events, observations, robots
from robomend.store.records import AuditEntry, IdempotencyKey, Paging, StoredBatch
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


async def test_a_configuration_may_hold_any_json(store: Store) -> None:
    config = {"note": "NUL \x00, half \ud800, ∪", "deep": [[[{"x": None}]]], "n": 10**30, "f": 0.1}
    await store.write(lambda tx: robots.put(tx, "r1", config, expected=None))
    assert (await store.read(robots.get, "r1")).config == config
    with pytest.raises(InputError):
        await store.write(lambda tx: robots.put(tx, "r2", {"n": float("nan")}, expected=None))


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


async def test_a_cancelled_caller_takes_nothing_back(store: Store) -> None:
    await with_robots(store, "r1")
    task = asyncio.create_task(observe(store, "r1", entry("scan")))
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert await observe(store, "r1", entry("odom")) == 2
