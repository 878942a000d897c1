"""A new database and one that an older version left are the same; that of a newer robomend is left alone."""

from __future__ import annotations

import sqlite3
import uuid
from contextlib import closing
from pathlib import Path
from typing import Any

import psycopg
import pytest
from sqlalchemy import Connection, MetaData, inspect, select
from tests.api.test_process import told
from tests.postgres import PostgresServer
from tests.store.examples import entry, observe, owner

from robomend.errors import StoreError
from robomend.store import Store, agent_actions, api_keys, global_stop, journal, observations, repairs, schema
from robomend.store.database import Database
from robomend.store.portable import export, load
from robomend.store.records import IdempotencyKey

OLDER = ("1",)
"""The schemas of releases: tests/store/older/ has a database of each, with every kind of record, as a killed
service left it. When schema.py changes, add what the release before wrote (SQLite: `.dump`; PostgreSQL:
`pg_dump --inserts --no-owner`), and leave the files that are there as they are.
"""


def lay(url: str, version: str) -> None:
    """Put the database of that schema at the URL, which is an empty one."""
    kind = "sqlite" if url.startswith("sqlite") else "postgresql"
    script = (Path(__file__).parent / "older" / f"{version}.{kind}.sql").read_text(encoding="utf-8")
    if kind == "sqlite":
        with closing(sqlite3.connect(url.removeprefix("sqlite:///"))) as lite:
            lite.executescript(script)
    else:
        with psycopg.connect(url, autocommit=True) as server:
            server.execute(script.encode())


def differences(connection: Connection) -> list[object]:
    from alembic.autogenerate import compare_metadata
    from alembic.migration import MigrationContext

    context = MigrationContext.configure(connection, opts={"compare_type": True})
    return [
        found for found in compare_metadata(context, schema.metadata) if "alembic_version" not in str(found)
    ]


def everything(database: Database) -> dict[str, list[dict[str, Any]]]:
    """Return every row of every table, as the database says that they are."""
    with database.reading() as connection:
        found = MetaData()
        found.reflect(connection)
        return {
            table.name: sorted((dict(row) for row in connection.execute(select(table)).mappings()), key=str)
            for table in found.tables.values()
            if table.name != "sqlite_sequence"
        }


@pytest.mark.parametrize("version", OLDER)
def test_an_older_database_is_brought_up_to_date_and_nothing_is_lost(url: str, version: str) -> None:
    lay(url, version)
    database = Database(url)
    before = everything(database)
    assert all(before.values())  # the example has something of every kind
    database.prepare()
    after = everything(database)
    assert after.pop("alembic_version") == [{"version_num": schema.HEAD}]
    for name in before.keys() - {"alembic_version"}:
        known = before[name][0].keys()
        assert [{key: row[key] for key in known} for row in after[name]] == before[name], name
    assert all(row["folded"] == row["revision"] for row in after["robot_state"])
    assert all(row["revision"] == 0 for row in after["obs"])
    with database.reading() as connection:
        assert differences(connection) == []
    database.dispose()


@pytest.mark.anyio
@pytest.mark.parametrize("version", OLDER)
async def test_a_service_goes_on_with_an_older_database(url: str, version: str) -> None:
    lay(url, version)
    store = Store(url)
    await store.start()
    try:
        assert (await store.read(observations.obs, "r1")).revision == 2
        answered = IdempotencyKey("ada POST /robots/r1/observations", "key-1", "digest")
        assert await store.write(lambda tx: observations.observe(tx, "r1"), once=answered) == 1
        assert await observe(store, "r1", entry("scan")) == 3
        [running] = (await store.read(repairs.page, "r1", open_only=True)).items
        assert running.state == "executing"
        assert [intent.id for intent in await store.read(journal.unsettled, "r1")] == ["a:1"]
        assert [action.id for action in await store.read(agent_actions.waiting, "r1")] == ["a:2"]
        assert [key.name for key in await store.read(api_keys.every)] == ["robot-r1", "admin"]
        assert (await store.read(global_stop.get)).active
        fence = await store.ownership.acquire("r1")  # whose last owner was killed
        assert fence is not None
        assert await store.read(owner, "r1") == (store.ownership.instance, 2)
        new = await store.write(lambda tx: repairs.create(tx, "r1", state="waiting", data={}, fence=fence))
        assert new.number == running.number + 1
    finally:
        await store.close()


@pytest.mark.parametrize("version", OLDER)
def test_what_an_older_database_held_can_be_exported_and_imported(
    url: str, version: str, tmp_path: Path
) -> None:
    lay(url, version)
    lines = list(export(Database(url)))
    new = Database(f"sqlite:///{tmp_path}/new.db")
    assert load(new, lines) == len(lines) - 2
    kept, taken = everything(Database(url)), everything(new)
    for left_out in ("batch_jobs", "instances", "sign_ins", "notifications", "moments", "moment_pieces"):
        for rows in (kept, taken):
            rows.pop(left_out, None)
    for row in kept["robot_state"]:
        row["owner"] = None
    assert taken == kept


def test_a_new_database_has_the_schema_of_the_program(url: str) -> None:
    database = Database(url)
    database.prepare()
    database.prepare()
    with database.reading() as connection:
        assert differences(connection) == []
        assert set(inspect(connection).get_table_names()) == set(schema.metadata.tables) | (
            {"sqlite_sequence"} & set(inspect(connection).get_table_names())
        )
        counters = connection.execute(schema.counters.select().order_by(schema.counters.c.name)).all()
        assert [tuple(row) for row in counters] == [("audit", 0), ("event", 0)]
    database.dispose()


def test_a_database_of_a_newer_robomend_is_refused_and_left_alone(url: str) -> None:
    database = Database(url)
    database.prepare()
    connection = database.open_writer()
    with connection.begin():
        connection.execute(schema.version.update().values(version_num="9999"))
    connection.close()
    with pytest.raises(StoreError, match="9999"):
        database.prepare()
    with database.reading() as reading:
        assert reading.execute(schema.version.select()).scalar() == "9999"
    database.dispose()


@pytest.mark.parametrize("version", ["0001", "0010"])
def test_a_database_of_a_development_version_is_refused_in_one_sentence_and_left_alone(
    url: str, version: str, tmp_path: Path
) -> None:
    database = Database(url)
    database.prepare()
    with closing(database.open_writer()) as connection, connection.begin():
        connection.execute(schema.version.update().values(version_num=version))
    for command in ("serve --port 0", "export"):
        code, out, err = told(tmp_path, *command.split(), "--database", url)  # to serve sets up a log
        assert (code, out) == (3, "")
        [line] = err.splitlines()
        assert f"schema '{version}' of a development version" in line
    with database.reading() as reading:
        assert reading.execute(schema.version.select()).scalar() == version
    database.dispose()


def test_a_server_without_a_locale_gives_text_and_not_bytes(
    postgres_server: PostgresServer, postgres_url: str
) -> None:
    name = f"ascii_{uuid.uuid4().hex}"
    with psycopg.connect(postgres_url, autocommit=True) as admin:
        admin.execute(
            f"CREATE DATABASE {name} ENCODING 'SQL_ASCII' LC_COLLATE 'C' LC_CTYPE 'C' TEMPLATE template0"
        )
    database = Database(postgres_server.url(name))
    database.prepare()
    with closing(database.open_writer()) as connection, connection.begin():
        connection.execute(schema.counters.insert(), {"name": "Žižka", "value": 1})
        found = connection.execute(select(schema.counters.c.name)).scalars().all()
    database.dispose()
    with psycopg.connect(postgres_url, autocommit=True) as admin:
        admin.execute(f"DROP DATABASE {name} WITH (FORCE)")
    assert "Žižka" in found
