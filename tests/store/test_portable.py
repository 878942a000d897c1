"""Export, import and backup: everything comes back, on either kind of database."""

from __future__ import annotations

import asyncio
import json
import sqlite3
from pathlib import Path

import pytest
from tests.store.examples import entry, observe, with_robots

from robomend.errors import InputError, OptionRefused, StateConflict
from robomend.store import open_store, portable, schema
from robomend.store.interface import Store, Transaction
from robomend.store.records import AuditEntry, IdempotencyKey, Quarantine, StoredAssertion, StoredAttempt

pytestmark = pytest.mark.anyio


async def with_everything(store: Store) -> None:
    """Put at least one row into every table that is exported."""
    await with_robots(store, "r1")
    fence = await store.ownership.acquire("r1")
    assert fence is not None
    await observe(store, "r1", entry("scan"), entry("odom", False))

    def fill(tx: Transaction) -> None:
        tx.observe("r1", asserted=[StoredAssertion("night", "ok(x) or ok(y)", "ada", 1)])
        tx.record_diagnosis("r1", 1, {"diagnoses": []})
        repair = tx.create_repair("r1", state="running", data={"é": "∪"}, fence=fence).id
        tx.ask(repair, "cancel", by="ada", reason="")
        tx.put_step(repair, 0, state="done", data={}, fence=fence)
        tx.intend(repair, 0, action="x:0", name="n", parameters=["p"], timeout_s=0.5, fence=fence)
        tx.remember(StoredAttempt("r1", ("a",), ("b",), False, True, repair, 1), fence=fence)
        tx.put_quarantine(Quarantine("r1", "c", "why", 1, 1, None), fence=fence)
        tx.count_attempt("r1", "c", repair, fence=fence)
        tx.queue_action("x:0", "r1", host=None, name="n", parameters=[], timeout_s=1)
        tx.add_key(name="k", hash="h", role="admin", robot=None, by="ada")
        tx.set_stop(True, by="ada", reason="smoke")
        tx.note(AuditEntry("ada", "everything", "r1", before={}, after={"x": [1]}))

    await store.write(fill, once=IdempotencyKey("ada", "k", "digest"))


def rows(lines: list[str]) -> list[str]:
    """Return the lines of an export without what differs by design."""
    return [line for line in lines if '"table":' in line]


async def test_an_export_holds_everything_and_comes_back_on_either_kind(store: Store, tmp_path: Path) -> None:
    await with_everything(store)
    lines = list(store.export())
    tables = {json.loads(line)["table"] for line in rows(lines)}
    assert tables == {table.name for table in portable.TABLES}
    assert tables == set(schema.metadata.tables) - {"alembic_version", "instances", "sign_ins"}

    other = open_store(f"sqlite:///{tmp_path}/other.db")
    assert other.load(lines) == len(lines) - 2
    assert rows(list(other.export())) == rows(lines)
    await other.start()
    repair = (await other.read(lambda db: db.repairs("r1"))).items[0]
    assert repair.data == {"é": "∪"}
    assert await other.ownership.acquire("r1") is not None
    assert (await other.read(lambda db: db.owner("r1"))).fence == 2  # type: ignore[union-attr]  # just acquired
    assert await observe(other, "r1", entry("scan")) == 3
    assert [e.id for e in await other.read(lambda db: db.events(0))] == [1, 2]
    await other.close()


async def test_an_import_into_postgresql_goes_on_with_the_numbers(tmp_path: Path, postgres_url: str) -> None:
    source, target = open_store(f"sqlite:///{tmp_path}/a.db"), open_store(postgres_url)
    await source.start()
    await with_everything(source)
    lines = list(source.export())
    await source.close()
    target.load(lines)
    assert rows(list(target.export())) == rows(lines)
    await target.start()
    await with_robots(target, "r2")
    old = (await target.read(lambda db: db.repairs())).items[0]
    new = await target.write(lambda tx: tx.create_repair("r2", state="waiting", data={}))
    assert new.number == old.number + 1
    await target.close()


async def test_an_import_is_taken_whole_or_not_at_all(store: Store, tmp_path: Path) -> None:
    await with_everything(store)
    lines = list(store.export())
    broken = {
        "cut off": lines[:-1],
        "empty": [],
        "no export": ["{}\n"],
        "not json": [lines[0], "{\n"],
        "a list": [lines[0], "[]\n"],
        "another schema": [lines[0].replace(schema.HEAD, "0000"), *lines[1:]],
        "unknown table": [lines[0], '{"table":"x","row":{}}\n'],
        "missing column": [lines[0], '{"table":"models","row":{"name":"x"}}\n'],
        "a line lost": [*lines[:5], *lines[6:]],
    }
    for number, (_name, bad) in enumerate(broken.items()):
        target = open_store(f"sqlite:///{tmp_path}/{number}.db")
        with pytest.raises(InputError):
            target.load(bad)
        assert len(rows(list(target.export()))) == 2  # the counters
        assert target.load(lines) == len(lines) - 2
        with pytest.raises(StateConflict):
            target.load(lines)


async def test_a_backup_taken_under_load_is_one_consistent_moment(tmp_path: Path) -> None:
    store = open_store(f"sqlite:///{tmp_path}/robomend.db")
    await store.start()
    await with_robots(store, "r1")
    stop = asyncio.Event()

    async def load() -> None:
        while not stop.is_set():
            await observe(store, "r1", entry("scan"))

    loading = asyncio.create_task(load())
    await asyncio.sleep(0.1)
    before = await store.read(lambda db: db.revision("r1"))
    await store.backup(tmp_path / "copy.db")
    stop.set()
    await loading
    with pytest.raises(StateConflict):
        await store.backup(tmp_path / "copy.db")
    await store.close()
    assert sorted(p.name for p in tmp_path.glob("copy*")) == ["copy.db"]
    connection = sqlite3.connect(tmp_path / "copy.db")
    assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    connection.close()
    copy = open_store(f"sqlite:///{tmp_path}/copy.db")
    await copy.start()
    revision = await copy.read(lambda db: db.revision("r1"))
    assert revision >= before
    assert (await copy.read(lambda db: db.event_range())).newest == revision
    await copy.close()


async def test_a_backup_of_postgresql_is_left_to_its_own_tool(postgres_url: str, tmp_path: Path) -> None:
    store = open_store(postgres_url)
    await store.start()
    with pytest.raises(OptionRefused, match="pg_dump"):
        await store.backup(tmp_path / "copy")
    await store.close()
