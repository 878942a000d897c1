"""A new database and a migrated one are the same; a database of a newer robomend is left alone."""

from __future__ import annotations

from pathlib import Path

import pytest
from sqlalchemy import Connection, inspect

from robomend.errors import StoreError
from robomend.store import schema
from robomend.store.database import Database


def migrate_from_nothing(url: str, to: str = "head") -> Database:
    """Create the schema as Alembic does, from the first migration to the last or the one named."""
    from robomend.store.migrations import upgrade

    database = Database(url)
    if database.path is not None:
        database.path.touch()
    connection = database.open_writer()
    with connection.begin():
        upgrade(connection, "", to)
    connection.close()
    return database


def differences(connection: Connection) -> list[object]:
    from alembic.autogenerate import compare_metadata
    from alembic.migration import MigrationContext

    context = MigrationContext.configure(connection, opts={"compare_type": True})
    return [
        found for found in compare_metadata(context, schema.metadata) if "alembic_version" not in str(found)
    ]


def test_the_migrations_lead_to_the_schema_of_the_program(url: str) -> None:
    database = migrate_from_nothing(url)
    with database.reading() as connection:
        assert differences(connection) == []
    database.prepare()
    with database.reading() as connection:
        counters = connection.execute(schema.counters.select().order_by(schema.counters.c.name)).all()
        assert [tuple(row) for row in counters] == [("audit", 0), ("event", 0)]
    database.dispose()


def test_a_new_database_has_the_schema_of_the_program(url: str) -> None:
    database = Database(url)
    database.prepare()
    database.prepare()
    with database.reading() as connection:
        assert differences(connection) == []
        assert set(inspect(connection).get_table_names()) == set(schema.metadata.tables) | (
            {"sqlite_sequence"} & set(inspect(connection).get_table_names())
        )
    database.dispose()


def test_the_program_is_at_the_last_migration() -> None:
    from alembic.script import ScriptDirectory

    from robomend.store.migrations import configuration

    assert ScriptDirectory.from_config(configuration()).get_current_head() == schema.HEAD


def test_an_older_database_is_brought_up_to_date_with_what_it_holds(url: str) -> None:
    database = migrate_from_nothing(url, "0001")
    connection = database.open_writer()
    with connection.begin():
        connection.execute(schema.settings.insert().values(name="stop", value="{}"))
    connection.close()
    database.prepare()
    with database.reading() as reading:
        assert differences(reading) == []
        assert reading.execute(schema.version.select()).scalar() == schema.HEAD
        assert reading.execute(schema.settings.select()).first() == ("stop", "{}")
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


def test_every_file_of_the_migrations_is_in_the_package() -> None:
    import robomend.store.migrations as migrations

    assert migrations.__file__ is not None
    versions = Path(migrations.__file__).parent / "versions"
    found = sorted(path.name for path in versions.glob("[0-9]*.py"))
    assert found == ["0001_initial.py", "0002_sign_ins.py"]
