"""Databases as older versions left them: killed, not closed, with every kind of record in them.

    0002.sqlite.sql, 0002.postgresql.sql   by robomend 0.1.0 before its first release
    0005.sqlite.sql, 0005.postgresql.sql   the same, brought up to date and written to by a later one
    0006.sqlite.sql, 0006.postgresql.sql   the same once more, with a result that rows have in common
    0007.sqlite.sql, 0007.postgresql.sql   what the next one has beside that: a batch
    0008.sqlite.sql, 0008.postgresql.sql   what the one after has beside that: changes of two robots,
                                           with a log of events that begins later than the history
    0007.drills.sqlite.sql                 rows of another of that version, in place of its own: drills that
                                           ended, and three under way

When the schema changes, add what the version before wrote (SQLite: `.dump`; PostgreSQL: `pg_dump --inserts`),
or what it has beside the one before it (`BESIDE`), and leave the files that are here as they are.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import psycopg
from sqlalchemy import create_engine

from robomend.store.migrations import upgrade

HERE = Path(__file__).parent

EVIDENCE = "".join(
    f"ALTER TABLE obs ADD COLUMN {name} BIGINT;" for name in ("since_ns", "onset_ns", "settled")
)
CHANGES = {"0003": f"{EVIDENCE} UPDATE alembic_version SET version_num = '0003';"}
"""What the migration to a later version wrote into such a database."""

BESIDE = {"0007": "0006", "0008": "0007"}
"""Versions of which only what they add is here -> what they add it to."""

BROUGHT_UP = {"0009": "0008"}
"""Versions whose databases are those of an earlier one, brought up to them by the migrations."""

BEFORE_SIGN_INS = "DROP TABLE sign_ins; UPDATE alembic_version SET version_num = '0001';"


def lay(url: str, version: str) -> None:
    """Put the database of that schema at the URL, which is an empty one."""
    if version in BROUGHT_UP:
        lay(url, BROUGHT_UP[version])
        engine = create_engine(url)
        with engine.begin() as connection:
            upgrade(connection, BROUGHT_UP[version], version)
        engine.dispose()
        return
    left = version if (HERE / f"{version}.sqlite.sql").exists() else "0002"
    files = [left]
    while files[0] in BESIDE:
        files.insert(0, BESIDE[files[0]])
    change = BEFORE_SIGN_INS if version == "0001" else CHANGES.get(version, "")
    kind = "sqlite" if url.startswith("sqlite") else "postgresql"
    script = "".join((HERE / f"{one}.{kind}.sql").read_text(encoding="utf-8") for one in files) + change
    if kind == "sqlite":
        with closing(sqlite3.connect(url.removeprefix("sqlite:///"))) as lite:
            lite.executescript(script)
    else:
        with psycopg.connect(url, autocommit=True) as server:
            server.execute(script.encode())
