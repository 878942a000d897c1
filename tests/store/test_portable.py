"""Export, import and backup: everything comes back, on either kind of database."""

from __future__ import annotations

import asyncio
import json
import sqlite3
from pathlib import Path

import pytest
from tests.store.examples import entry, observe, owner, with_robots

from robomend.errors import InputError, OptionRefused, StateConflict
from robomend.store import (
    Store,
    Transaction,
    agent_actions,
    api_keys,
    attempts,
    diagnoses,
    drills,
    events,
    global_stop,
    journal,
    observations,
    portable,
    repairs,
    schema,
    start_ups,
)
from robomend.store.database import Database
from robomend.store.encoding import Common, Encoded
from robomend.store.portable import backup, export, load
from robomend.store.records import (
    AuditEntry,
    IdempotencyKey,
    Quarantine,
    StoredAssertion,
    StoredAttempt,
    StoredStart,
)

pytestmark = pytest.mark.anyio


async def with_everything(store: Store) -> None:
    """Put at least one row into every table that is exported."""
    await with_robots(store, "r1")
    fence = await store.ownership.acquire("r1")
    assert fence is not None
    await observe(store, "r1", entry("scan"), entry("odom", False))

    def fill(tx: Transaction) -> None:
        observations.observe(tx, "r1", asserted=[StoredAssertion("night", "ok(x) or ok(y)", "ada", 1)])
        diagnoses.record(tx, "r1", 2, Encoded.around({"a": 1, "b": 2}, '{"a":1,', Common('"b":2'), "}"))
        diagnoses.record(tx, "r1", 1, {"diagnoses": []})
        tx.bring_up("r1")
        repair = repairs.create(tx, "r1", state="running", data={"é": "∪"}, fence=fence).id
        repairs.ask(tx, repair, "cancel", by="ada", reason="")
        repairs.put_step(tx, repair, 0, state="done", data={}, fence=fence)
        journal.intend(tx, repair, 0, action="x:0", name="n", parameters=["p"], timeout_s=0.5, fence=fence)
        attempts.remember(tx, StoredAttempt("r1", ("a",), ("b",), False, True, repair, 1), fence=fence)
        attempts.put_quarantine(tx, Quarantine("r1", "c", "why", 1, 1, None), fence=fence)
        attempts.count(tx, "r1", "c", repair, fence=fence)
        start_ups.keep(
            tx,
            "r1",
            {
                "scan": [StoredStart(8, 8, False)],
                "map": [StoredStart(9, 2, True), StoredStart(9, 9, True, True)],
            },
        )
        drills.create(tx, "r1", state="waiting", data={"fault": "node-killed"})
        agent_actions.queue(tx, "x:0", "r1", host=None, name="n", parameters=[], timeout_s=1)
        api_keys.add(tx, name="k", hash="h", role="admin", robot=None, by="ada")
        global_stop.put(tx, True, by="ada", reason="smoke")
        tx.note(AuditEntry("ada", "everything", "r1", before={}, after={"x": [1]}))

    await store.write(fill, once=IdempotencyKey("ada", "k", "digest"))


def rows(lines: list[str]) -> list[str]:
    """Return the lines of an export without what differs by design."""
    return [line for line in lines if '"table":' in line]


async def test_an_export_holds_everything_and_comes_back_on_either_kind(
    store: Store, url: str, tmp_path: Path
) -> None:
    await with_everything(store)
    lines = list(export(Database(url)))
    tables = {json.loads(line)["table"] for line in rows(lines)}
    assert tables == {table.name for table in portable.TABLES}
    assert tables == set(schema.metadata.tables) - {
        "alembic_version",
        "batch_jobs",  # their files are not in the export
        "instances",
        "moment_pieces",
        "moments",
        "notifications",
        "sign_ins",
    }

    target = Database(f"sqlite:///{tmp_path}/other.db")
    assert load(target, lines) == len(lines) - 2
    assert rows(list(export(target))) == rows(lines)
    other = Store(f"sqlite:///{tmp_path}/other.db")
    await other.start()
    repair = (await other.read(repairs.page, "r1")).items[0]
    assert repair.data == {"é": "∪"}
    assert await other.ownership.acquire("r1") is not None
    assert (await other.read(owner, "r1"))[1] == 2
    assert await observe(other, "r1", entry("scan")) == 3
    assert [e.id for e in await other.read(events.after, 0)] == [1, 2, 3, 4, 5]
    assert [batch.revision for batch in (await other.read(observations.history, "r1")).items] == [3, 2, 1]
    assert {e.atom.args[0]: e.positive for e in (await other.read(observations.obs, "r1")).entries} == {
        "scan": True,
        "odom": False,
    }
    await other.close()


async def test_an_import_into_postgresql_goes_on_with_the_numbers(tmp_path: Path, postgres_url: str) -> None:
    source, target = Store(f"sqlite:///{tmp_path}/a.db"), Store(postgres_url)
    await source.start()
    await with_everything(source)
    await source.close()
    lines = list(export(Database(f"sqlite:///{tmp_path}/a.db")))
    load(Database(postgres_url), lines)
    assert rows(list(export(Database(postgres_url)))) == rows(lines)
    await target.start()
    await with_robots(target, "r2")
    old = (await target.read(repairs.page)).items[0]
    new = await target.write(lambda tx: repairs.create(tx, "r2", state="waiting", data={}))
    assert new.number == old.number + 1
    await target.close()


async def test_an_import_is_taken_whole_or_not_at_all(store: Store, url: str, tmp_path: Path) -> None:
    await with_everything(store)
    lines = list(export(Database(url)))
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
        target = Database(f"sqlite:///{tmp_path}/{number}.db")
        with pytest.raises(InputError):
            load(target, bad)
        assert len(rows(list(export(target)))) == 2  # the counters
        assert load(target, lines) == len(lines) - 2
        with pytest.raises(StateConflict):
            load(target, lines)


async def test_a_backup_taken_under_load_is_one_consistent_moment(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/robomend.db"
    store = Store(url)
    await store.start()
    await with_robots(store, "r1")
    stop = asyncio.Event()

    async def write() -> None:
        while not stop.is_set():
            await observe(store, "r1", entry("scan"))

    loading = asyncio.create_task(write())
    while (before := await store.read(observations.revision, "r1")) < 5:
        await asyncio.sleep(0)
    await asyncio.to_thread(backup, Database(url), tmp_path / "copy.db")
    stop.set()
    await loading
    with pytest.raises(StateConflict):
        backup(Database(url), tmp_path / "copy.db")
    await store.close()
    assert sorted(p.name for p in tmp_path.glob("copy*")) == ["copy.db"]
    connection = sqlite3.connect(tmp_path / "copy.db")
    assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    connection.close()
    copy = Store(f"sqlite:///{tmp_path}/copy.db")
    await copy.start()
    revision = await copy.read(observations.revision, "r1")
    assert revision >= before
    assert (await copy.read(events.kept)).newest == revision
    await copy.close()


def test_a_backup_of_postgresql_is_left_to_its_own_tool(postgres_url: str, tmp_path: Path) -> None:
    with pytest.raises(OptionRefused, match="pg_dump"):
        backup(Database(postgres_url), tmp_path / "copy")
