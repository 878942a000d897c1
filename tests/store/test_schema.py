"""A new database and one that an older version left are the same; that of a newer robomend is left alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import Connection, MetaData, inspect, select
from tests.store.examples import entry, observe, owner
from tests.store.older import lay

from robomend.errors import StoreError
from robomend.store import Store, agent_actions, api_keys, global_stop, journal, observations, repairs, schema
from robomend.store.database import Database
from robomend.store.encoding import digest
from robomend.store.portable import export, load
from robomend.store.records import IdempotencyKey

OLDER = ("0001", "0002", "0003", "0005", "0006", "0007", "0008", "0009")


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


def check_log(before: dict[str, list[dict[str, Any]]], after: dict[str, list[dict[str, Any]]]) -> None:
    """Check that one log has what were three; from the cut on its events are what they were."""

    def those(rows: list[dict[str, Any]], *keys: str) -> list[tuple[Any, ...]]:
        return sorted((tuple(row[key] for key in keys) for row in rows), key=str)

    log, same = after["events"], ("robot", "revision", "time_ns")
    batches = [row for row in log if row["batch"] is not None]
    assert those(batches, *same, "batch") == those(before["observations"], *same, "data")
    diagnosed = [row for row in log if row["kind"] == "diagnosis"]
    assert those(diagnosed, *same, "data") == those(before["diagnoses"], *same, "result")
    for kept, common in zip(those(diagnosed, *same), those(before["diagnoses"], *same), strict=True):
        assert kept == common
    [cut] = [row["value"] for row in after["counters"] if row["name"] == "events-cut"]
    after["counters"] = [row for row in after["counters"] if row["name"] != "events-cut"]
    told, as_it_was = ("id", "time_ns", "kind", "robot"), those(before["events"], "id")
    events = [row for row in log if row["id"] > cut]
    assert those(events, *told) == those(before["events"], *told)
    assert not as_it_was or min(as_it_was)[0] == cut + 1
    others = [row for row in before["events"] if row["kind"] != "diagnosis"]
    assert those([row for row in events if row["kind"] != "diagnosis"], *told, "data") == those(
        others, *told, "data"
    )
    of_robot: dict[str, list[int]] = {}
    for row in sorted(batches, key=lambda row: row["id"]):
        of_robot.setdefault(row["robot"], []).append(row["revision"])
    assert all(of_robot[robot] == sorted(of_robot[robot]) for robot in of_robot.keys() & {"r8", "r9"})


@pytest.mark.parametrize("version", OLDER)
def test_an_older_database_is_brought_up_to_date_and_nothing_is_lost(url: str, version: str) -> None:
    lay(url, version)
    database = Database(url)
    before = everything(database)
    assert all(before.values())  # the example has something of every kind
    database.prepare()
    after = everything(database)
    assert after.pop("alembic_version") == [{"version_num": schema.HEAD}]
    if "diagnoses" in before:
        check_log(before, after)
        keys = [IdempotencyKey(row["scope"], row["key"], "") for row in before["idempotency"]]
        assert [row["digest"].hex() for row in after["idempotency"]] == [digest(key.whole) for key in keys]
    for name in before.keys() - {"alembic_version", "observations", "diagnoses", "events", "idempotency"}:
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
    for left_out in ("batch_jobs", "instances", "sign_ins", "notifications"):
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


def test_the_version_before_is_among_the_older_ones() -> None:
    assert OLDER[-1] == f"{int(schema.HEAD) - 1:04}"


def test_the_program_is_at_the_last_migration() -> None:
    from alembic.script import ScriptDirectory

    from robomend.store.migrations import configuration

    assert ScriptDirectory.from_config(configuration()).get_current_head() == schema.HEAD


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


def test_every_file_of_the_migrations_is_in_the_package() -> None:
    import robomend.store.migrations as migrations

    assert migrations.__file__ is not None
    versions = Path(migrations.__file__).parent / "versions"
    found = sorted(path.name for path in versions.glob("[0-9]*.py"))
    assert found == [
        "0001_baseline.py",
        "0002_sign_ins.py",
        "0003_evidence.py",
        "0004_notifications.py",
        "0005_drills.py",
        "0006_results.py",
        "0007_batch_jobs.py",
        "0008_start_ups.py",
        "0009_one_log.py",
        "0010_readings.py",
    ]
