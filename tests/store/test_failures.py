"""When the database is gone, full, locked, slow or no database: clear errors, and recovery by itself."""

from __future__ import annotations

import asyncio
import os
import pickle
import sqlite3
import threading
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

import psycopg
import pytest
from tests.freezing import frozen
from tests.postgres import PostgresServer
from tests.store.examples import entry, observe, with_robots
from tests.waiting import eventually

from robomend.api.store_probe import StoreProbe
from robomend.errors import OptionRefused, RobomendError, StoreError, StoreFull, StoreOverloaded
from robomend.store import Store, Transaction, database, global_stop, observations, robots, writer
from robomend.store.bounded import BoundedConnection

pytestmark = pytest.mark.anyio


T = TypeVar("T")


async def at_last(ask: Callable[[], Awaitable[T]]) -> T:
    """Ask until the store has an answer, for at most 20 s."""
    async with asyncio.timeout(60):
        while True:
            with suppress(StoreError):
                return await ask()
            await asyncio.sleep(0.05)


async def test_a_server_that_went_away_is_an_error_until_it_is_back(
    postgres_server: PostgresServer, postgres_url: str
) -> None:
    store = Store(postgres_url)
    await store.start()
    try:
        await with_robots(store, "r1")
        assert await observe(store, "r1", entry("scan")) == 1
        heard: list[int] = []
        store.subscribe(lambda events: heard.extend(event.id for event in events))
        postgres_server.crash()
        try:
            with pytest.raises(StoreError):
                await observe(store, "r1", entry("lost"))
            with pytest.raises(StoreError):
                await store.read(observations.obs, "r1")
        finally:
            postgres_server.start()
        revision = await at_last(lambda: observe(store, "r1", entry("back")))
        obs = await store.read(observations.obs, "r1")
        assert obs.revision == revision
        assert {"scan", "back"} <= {e.atom.args[0] for e in obs.entries}
        await eventually(lambda: heard[-1:] == [revision], "the newest event is heard")
        assert heard == list(range(2, revision + 1))
    finally:
        await store.close()


async def test_connections_that_are_frozen_are_given_up_and_others_are_opened(
    postgres_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As if another server had taken the place of one that hangs."""
    monkeypatch.setattr(BoundedConnection, "answer_s", 0.5)
    store = Store(postgres_url)
    await store.start()
    try:
        await with_robots(store, "r1")
        await observe(store, "r1", entry("scan"))
        await store.read(observations.obs, "r1")  # a reader has a connection beside the writer's
        with psycopg.connect(postgres_url, autocommit=True) as admin:
            pids = admin.execute(
                "SELECT pid FROM pg_stat_activity"
                " WHERE datname = current_database() AND pid <> pg_backend_pid()"
            ).fetchall()
        with frozen(*(pid for (pid,) in pids)):
            revision = await at_last(lambda: observe(store, "r1", entry("back")))
            assert (await at_last(lambda: store.read(observations.obs, "r1"))).revision == revision
        assert await store.read(observations.obs, "r1")
    finally:
        await store.close()


async def test_a_connection_that_was_cut_while_idle_is_replaced_without_an_error(
    postgres_url: str,
) -> None:
    store = Store(postgres_url)
    await store.start()
    try:
        await with_robots(store, "r1")
        with psycopg.connect(postgres_url, autocommit=True) as admin:
            admin.execute(
                # a minute for each to be gone: one that is cut in the middle of a COMMIT cannot be repeated
                "SELECT pg_terminate_backend(pid, 60000) FROM pg_stat_activity"
                " WHERE datname = current_database() AND pid <> pg_backend_pid()"
            )
        assert await observe(store, "r1", entry("scan")) == 1
        assert (await store.read(observations.obs, "r1")).revision == 1
    finally:
        await store.close()


async def test_a_connection_that_is_cut_in_the_middle_of_a_change_repeats_its_group(
    postgres_url: str,
) -> None:
    store = Store(postgres_url)
    await store.start()
    cuts = 0

    def cut(tx: Transaction) -> int:
        nonlocal cuts
        cuts += 1
        connection = tx.connection
        robots.page(tx)  # behind this change's savepoint, which is lost with the connection
        if cuts == 1:
            pid = connection.exec_driver_sql("SELECT pg_backend_pid()").scalar()
            with psycopg.connect(postgres_url, autocommit=True) as admin:
                admin.execute("SELECT pg_terminate_backend(%s, 5000)", [pid])
        robots.page(tx)
        return cuts

    try:
        await with_robots(store, "r1")
        assert await store.write(cut) == 2
        assert await observe(store, "r1", entry("scan")) == 1
    finally:
        await store.close()


async def fill(store: Store, url: str) -> None:
    """Make the next writes find no room, as the database itself reports it."""
    if url.startswith("sqlite"):

        def no_more_pages(tx: Transaction) -> None:
            connection = tx.connection
            pages = connection.exec_driver_sql("PRAGMA page_count").scalar()
            connection.exec_driver_sql(f"PRAGMA max_page_count = {pages}")

        await store.write(no_more_pages)
    else:
        with psycopg.connect(url, autocommit=True) as admin:
            admin.execute(
                "CREATE FUNCTION full_disk() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN"
                " RAISE EXCEPTION 'could not extend file: No space left on device' USING ERRCODE = '53100';"
                " END $$"
            )
            admin.execute("CREATE TRIGGER t BEFORE INSERT ON events EXECUTE FUNCTION full_disk()")


async def make_room(store: Store, url: str) -> None:
    if url.startswith("sqlite"):

        def more_pages(tx: Transaction) -> None:
            connection = tx.connection
            connection.exec_driver_sql("PRAGMA max_page_count = 1000000")

        await store.write(more_pages)
    else:
        with psycopg.connect(url, autocommit=True) as admin:
            admin.execute("DROP TRIGGER t ON events")


async def test_a_full_disk_refuses_writes_and_reading_goes_on(
    store: Store, url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    await with_robots(store, "r1")
    await observe(store, "r1", entry("scan"))
    await fill(store, url)
    large = [entry(f"t{number}", source="x" * 500) for number in range(200)]
    with pytest.raises(StoreFull):
        await observe(store, "r1", *large)
    await store.ownership.beat()  # a small write may still fit
    known = StoreProbe(store).known
    assert not known.ok
    assert "store-full" in known.detail
    obs = await store.read(observations.obs, "r1")
    assert (obs.revision, len(obs.entries)) == (1, 1)
    await make_room(store, url)
    assert await observe(store, "r1", *large) == 2
    monkeypatch.setattr(database, "FULL_S", 0.0)
    assert StoreProbe(store).known.ok


async def test_too_many_writes_are_refused_at_once(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "MAX_QUEUED", 5)
    await with_robots(store, "r1")
    begun, go_on = threading.Event(), threading.Event()

    def slow(tx: Transaction) -> None:
        begun.set()
        go_on.wait(60)

    first = asyncio.create_task(store.write(slow))
    await asyncio.to_thread(begun.wait, 60)
    queued = [asyncio.create_task(observe(store, "r1", entry("scan"))) for _ in range(5)]
    await asyncio.sleep(0)
    assert store.figures().queued_writes == 5
    with pytest.raises(StoreOverloaded):
        await observe(store, "r1", entry("scan"))
    go_on.set()
    await first
    assert await asyncio.gather(*queued) == [1, 2, 3, 4, 5]


async def test_too_many_reads_are_refused_at_once(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "MAX_READS", 1)
    go_on = threading.Event()
    first = asyncio.create_task(store.read(lambda db: go_on.wait(60)))
    await asyncio.sleep(0)
    with pytest.raises(StoreOverloaded):
        await store.read(global_stop.get)
    go_on.set()
    assert await first


async def test_what_is_queued_at_the_end_is_still_written(url: str) -> None:
    store = Store(url)
    await store.start()
    await with_robots(store, "r1")
    tasks = [asyncio.create_task(observe(store, "r1", entry("scan"))) for _ in range(50)]
    await asyncio.sleep(0)
    await store.close()
    assert await asyncio.gather(*tasks) == list(range(1, 51))
    with pytest.raises(StoreError):
        await observe(store, "r1", entry("late"))
    with pytest.raises(StoreError):
        await store.read(global_stop.get)
    await store.close()
    again = Store(url)
    await again.start()
    assert await again.read(observations.revision, "r1") == 50
    await again.close()


async def test_what_cannot_be_reached_or_is_no_database_is_an_error(tmp_path: Path) -> None:
    (blocked := tmp_path / "file").write_text("not a directory")
    (random := tmp_path / "random.db").write_bytes(os.urandom(8192))
    for url in (
        f"sqlite:///{blocked}/x.db",
        f"sqlite:///{random}",
        f"postgresql://nobody@/none?host={tmp_path}",
    ):
        store = Store(url)
        with pytest.raises(StoreError) as raised:
            await store.start()
        assert pickle.loads(pickle.dumps(raised.value)).args == raised.value.args
        await store.close()


def test_postgresql_without_its_driver_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(database, "find_spec", lambda name: None)
    with pytest.raises(OptionRefused, match=r"pip install 'robomend\[postgres\]'"):
        Store("postgresql://ada@host/name")


async def test_a_password_is_in_no_message(tmp_path: Path) -> None:
    store = Store(f"postgresql://ada:secret@/none?host={tmp_path}")
    assert "secret" not in store.url
    with pytest.raises(StoreError) as raised:
        await store.start()
    assert "secret" not in str(raised.value)
    for url in ("mysql://ada:secret@host/x", "sqlite://", "nonsense", "sqlite:///:memory:"):
        with pytest.raises(RobomendError) as refused:
            Store(url)
        assert "secret" not in str(refused.value)
    await store.close()


async def test_a_sqlite_database_can_be_read_by_its_owner_only(tmp_path: Path) -> None:
    path = tmp_path / "data" / "robomend.db"
    store = Store(f"sqlite:///{path}")
    await store.start()
    await with_robots(store, "r1")
    modes = {p.name: p.stat().st_mode & 0o077 for p in [path.parent, *path.parent.glob("*.db*")]}
    assert set(modes.values()) == {0}
    await store.close()


# --- processes write one SQLite file in turns: who waits goes on as soon as it is free, or is told


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
    monkeypatch.undo()
    assert (await store.write(lambda tx: global_stop.put(tx, True, by="ann", reason="smoke"))).active
    await store.close()
