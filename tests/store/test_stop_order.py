"""An intent comes wholly before a stop or a cancellation, or sees it, whichever instance writes which."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable

import pytest
from tests.store.examples import with_robots

from robomend.store import Store, Transaction, global_stop, repairs

pytestmark = pytest.mark.anyio

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
