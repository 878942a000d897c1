"""SQLite's file is damaged or cut off: it is refused, or found when it is read, and never silently."""

from __future__ import annotations

import os
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from tests.store.examples import entry, observe, with_robots

from robomend.errors import StoreDamaged
from robomend.store import Store, observations
from robomend.store.records import AuditEntry

pytestmark = pytest.mark.anyio


async def written(path: Path) -> None:
    """Make a database with a robot and what was observed of it."""
    store = Store(f"sqlite:///{path}")
    await store.start()
    await with_robots(store, "r1")
    await observe(store, "r1", *[entry(f"t{number}") for number in range(100)])
    await store.close()


def overwrite(path: Path, table: str) -> None:
    """Put what SQLite never writes where a table begins."""
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        (page,) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = ?", [table]).fetchone()
        (bytes_a_page,) = connection.execute("PRAGMA page_size").fetchone()
    with path.open("r+b") as file:
        file.seek((page - 1) * bytes_a_page)
        file.write(b"\xff" * bytes_a_page)


@pytest.mark.parametrize("missing", [1, 1000, 50_000])
async def test_a_file_of_which_the_end_is_missing_is_refused_with_what_to_do(
    tmp_path: Path, missing: int
) -> None:
    path = tmp_path / "robomend.db"
    await written(path)
    whole = path.stat().st_size
    os.truncate(path, whole - missing)
    store = Store(f"sqlite:///{path}")
    with pytest.raises(StoreDamaged, match="put a copy in its place") as refused:
        await store.start()
    if missing < 50_000:  # of more that is missing SQLite itself stumbles
        assert f"has {whole - missing} bytes of {whole}" in str(refused.value)
    await store.close()
    assert path.stat().st_size == whole - missing


async def test_what_is_only_in_the_write_ahead_log_is_not_missing(tmp_path: Path) -> None:
    path, copy = tmp_path / "robomend.db", tmp_path / "copy.db"
    store = Store(f"sqlite:///{path}")
    await store.start()
    await with_robots(store, "r1")
    await observe(store, "r1", *[entry(f"t{number}") for number in range(100)])
    for end in ("", "-wal"):  # as after kill -9
        shutil.copy(f"{path}{end}", f"{copy}{end}")
    await store.close()
    assert copy.stat().st_size < path.stat().st_size
    again = Store(f"sqlite:///{copy}")
    await again.start()
    assert len((await again.read(observations.obs, "r1")).entries) == 100
    await again.close()


async def test_damage_that_a_write_finds_is_told_and_remembered(tmp_path: Path) -> None:
    path = tmp_path / "robomend.db"
    await written(path)
    overwrite(path, "audit")
    store = Store(f"sqlite:///{path}")
    await store.start()
    assert store.damage is None
    with pytest.raises(StoreDamaged, match="malformed"):
        await store.write(lambda tx: tx.note(AuditEntry("ada", "x", "r1")))
    assert len((await store.read(observations.obs, "r1")).entries) == 100
    assert store.damage is not None
    assert "put a copy in its place" in store.damage
    await store.close()
