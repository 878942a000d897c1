"""The event log: order, replay, and live delivery within a process and across instances."""

from __future__ import annotations

import asyncio
from functools import partial

import pytest
from tests.store.examples import entry, with_robots
from tests.waiting import eventually

from robomend.store import Store, Transaction, View, diagnoses, events, observations
from robomend.store.store import Tail
from robomend_client.events import Event, Kind

pytestmark = pytest.mark.anyio


async def emit(store: Store, *robots: str | None) -> None:
    def change(tx: Transaction) -> None:
        for robot in robots:
            tx.emit(Kind.ROBOT, robot, {"by": robot})

    await store.write(change)


async def test_subscribers_hear_the_events_of_all_instances_in_order(store: Store, second: Store) -> None:
    """Both instances write at once; each hears the same log."""
    heard: dict[str, list[int]] = {"first": [], "second": []}
    store.subscribe(lambda events: heard["first"].extend(e.id for e in events))
    end = second.subscribe(lambda events: heard["second"].extend(e.id for e in events))
    await asyncio.gather(*(emit(who, "a", "b") for _ in range(100) for who in (store, second)))
    await eventually(lambda: min(len(ids) for ids in heard.values()) >= 400, "all events are heard")
    assert heard["first"] == heard["second"] == list(range(1, 401))
    end()
    await emit(store, "c")
    await eventually(lambda: len(heard["first"]) == 401, "the event in the one that still listens")
    assert len(heard["second"]) == 400


def events_after(last: int, db: View) -> tuple[Event, ...]:
    return events.after(db, last)


async def test_readers_never_see_an_id_before_a_smaller_one(store: Store, second: Store) -> None:
    """A reader who resumes after the largest id seen would otherwise miss the one that commits late."""
    writing = asyncio.gather(*(emit(who, "x") for _ in range(150) for who in (store, second)))
    seen: list[int] = []
    async with asyncio.timeout(60):
        while len(seen) < 300:
            last = seen[-1] if seen else 0
            seen += [e.id for e in await store.read(partial(events_after, last))]
    await writing
    assert seen == list(range(1, 301))


async def test_a_tail_that_falls_behind_reads_the_log() -> None:
    """Own commits that do not follow on the last event make it read what is between."""
    log = [Event(n, n, Kind.ROBOT, "r", {}) for n in range(1, 20)]

    async def read(after: int) -> tuple[Event, ...]:
        await asyncio.sleep(0)
        return tuple(e for e in log if after < e.id <= after + 3)

    tail = Tail(read)
    tail.start(2)
    heard: list[int] = []
    tail.listen(lambda events: heard.extend(e.id for e in events))
    tail.committed(tuple(log[2:4]))
    tail.committed(tuple(log[8:10]))
    await asyncio.sleep(0)
    tail.committed(tuple(log[10:12]))
    tail.sign(15)
    await eventually(lambda: tail.last >= 15, "the tail is there")
    assert heard == list(range(3, tail.last + 1))
    await tail.close()


async def test_a_listener_that_fails_takes_no_event_from_the_others(store: Store) -> None:
    loop = asyncio.get_running_loop()
    told: list[object] = []
    loop.set_exception_handler(lambda _, context: told.append(context["exception"]))
    failure = ZeroDivisionError()

    def fail(events: tuple[Event, ...]) -> None:
        raise failure

    heard: list[int] = []
    store.subscribe(fail)
    store.subscribe(lambda events: heard.extend(event.id for event in events))
    await emit(store, "a", "b")
    await asyncio.sleep(0)
    loop.set_exception_handler(None)
    assert (heard, told) == ([1, 2], [failure])


async def test_an_own_commit_that_overtakes_a_read_of_the_log_comes_once() -> None:
    log = [Event(n, n, Kind.ROBOT, "r", {}) for n in range(1, 5)]
    reading, go_on = asyncio.Event(), asyncio.Event()

    async def read(after: int) -> tuple[Event, ...]:
        found = tuple(event for event in log if event.id > after)
        reading.set()
        await go_on.wait()
        return found

    tail = Tail(read)
    tail.start(0)
    heard: list[int] = []
    tail.listen(lambda events: heard.extend(event.id for event in events))
    tail.sign(2)
    await reading.wait()
    tail.committed(tuple(log[:3]))
    go_on.set()
    await eventually(lambda: tail.last >= 4, "the tail is there")
    assert heard == [1, 2, 3, 4]
    await tail.close()


async def test_a_page_may_end_between_the_two_events_of_a_change(store: Store) -> None:
    await with_robots(store, "r1")

    def change(tx: Transaction) -> None:
        revision = observations.observe(tx, "r1", accepted=[entry("scan")], changed=[entry("scan")])
        diagnoses.record(tx, "r1", revision, {"revision": revision})

    for _ in range(2):
        await store.write(change)
    whole = await store.read(events.after, 0)
    assert [(event.id, event.kind, event.data["revision"]) for event in whole] == [
        (1, Kind.OBSERVATIONS, 1),
        (2, Kind.DIAGNOSIS, 1),
        (3, Kind.OBSERVATIONS, 2),
        (4, Kind.DIAGNOSIS, 2),
    ]
    for robot in (None, "r1"):
        for first in range(4):
            assert await store.read(events.after, first, robot=robot, limit=1) == whole[first : first + 1]
            assert await store.read(events.after, first, robot=robot, limit=2) == whole[first : first + 2]
