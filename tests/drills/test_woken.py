"""What wakes a drill that is under way: what it watches may be over in the time between two looks."""

from __future__ import annotations

import asyncio
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from robomend.drills.drills import Drills
from robomend.store import Store, Transaction
from robomend_client.events import Kind

pytestmark = pytest.mark.anyio


@pytest.mark.parametrize("kind", [Kind.DIAGNOSIS, Kind.REPAIR])
async def test_a_diagnosis_and_a_repair_wake_the_drill_of_their_robot(tmp_path: Path, kind: Kind) -> None:
    store = Store(f"sqlite:///{tmp_path}/robomend.db")
    await store.start()
    drills = Drills(cast(Any, SimpleNamespace(store=store, switch=SimpleNamespace(on_change=lambda _: None))))
    await drills.start()
    news = {robot: asyncio.Event() for robot in ("r1", "r2")}
    for robot, event in news.items():
        drills._running[robot] = cast(Any, (SimpleNamespace(news=event), None, None))

    def emit(tx: Transaction) -> None:
        tx.emit(kind, "r1", {"revision": 1})

    try:
        await store.write(emit, robots=())
        async with asyncio.timeout(60):
            await news["r1"].wait()
        assert not news["r2"].is_set()
    finally:
        drills._running.clear()
        await drills.close()
        await store.close()
