"""Processes write one SQLite file in turns: who waits goes on as soon as it is free, or is told."""

from __future__ import annotations

import asyncio
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from robomend.errors import StoreError
from robomend.store import Store, database, global_stop

pytestmark = pytest.mark.anyio


async def test_a_writer_waits_for_another_process_and_then_writes(tmp_path: Path) -> None:
    path = tmp_path / "robomend.db"
    store = Store(f"sqlite:///{path}")
    await store.start()
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    writing = asyncio.ensure_future(
        store.write(lambda tx: global_stop.put(tx, True, by="ann", reason="smoke"))
    )
    await asyncio.sleep(0.2)  # many turns
    assert not writing.done()
    other.execute("ROLLBACK")
    assert (await writing).active
    other.close()
    await store.close()


async def test_one_who_waits_for_too_long_is_told_and_the_next_write_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "robomend.db"
    store = Store(f"sqlite:///{path}")
    await store.start()
    monkeypatch.setattr(database, "BUSY_TIMEOUT_S", 0.2)
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    with pytest.raises(StoreError, match=r"kept the database locked for 0\.2 s"):
        await store.write(lambda tx: global_stop.put(tx, True, by="ann", reason="smoke"))
    other.execute("ROLLBACK")
    other.close()
    assert (await store.write(lambda tx: global_stop.put(tx, True, by="ann", reason="smoke"))).active
    await store.close()


def test_a_writers_connection_waits_again_when_it_is_a_readers(tmp_path: Path) -> None:
    opened = database.Database(f"sqlite:///{tmp_path}/robomend.db")
    opened.prepare()
    with closing(opened.open_writer()) as writer:
        with writer.begin():
            assert writer.exec_driver_sql("PRAGMA busy_timeout").scalar() == 0
        used = writer.connection.driver_connection
    with opened.reading() as reader:
        assert reader.connection.driver_connection is used
        assert reader.exec_driver_sql("PRAGMA busy_timeout").scalar() == database.BUSY_TIMEOUT_S * 1000
    opened.dispose()
