"""What is handed to the driver directly fails as what goes through SQLAlchemy does."""

from __future__ import annotations

import sqlite3
from contextlib import closing

import psycopg
import pytest
from sqlalchemy import exc, select

from robomend.store import schema
from robomend.store.database import Database
from robomend.store.prepared import Prepared, driver_of, translated

COUNTERS = Prepared(lambda _: schema.counters.insert(), ["name", "value"])


def test_rows_are_written_and_a_refused_one_is_sqlalchemys_error(url: str) -> None:
    database = Database(url)
    database.prepare()
    with closing(database.open_writer()) as connection:
        with connection.begin():
            COUNTERS.run(connection, [{"name": "a", "value": 1}, {"name": "b", "value": 2**40}])
        with pytest.raises(exc.IntegrityError) as refused, connection.begin():
            COUNTERS.run(connection, [{"name": "c", "value": 3}, {"name": "a", "value": 3}])
        assert not refused.value.connection_invalidated
        rows = connection.execute(select(schema.counters).order_by(schema.counters.c.name)).all()
        assert [tuple(row) for row in rows] == [("a", 1), ("audit", 0), ("b", 2**40), ("event", 0)]
    database.dispose()


def test_a_lost_connection_is_known_as_lost(postgres_url: str) -> None:
    database = Database(postgres_url)
    database.prepare()
    connection = database.open_writer()
    connection.begin()
    with psycopg.connect(postgres_url, autocommit=True) as other:
        other.execute("SELECT pg_terminate_backend(%s)", [driver_of(connection).info.backend_pid])
    with pytest.raises(exc.DBAPIError) as lost:
        COUNTERS.run(connection, [{"name": "a", "value": 1}])
    assert lost.value.connection_invalidated
    assert connection.invalidated
    database.dispose()


def test_only_the_drivers_errors_are_translated(tmp_path: object) -> None:
    database = Database(f"sqlite:///{tmp_path}/robomend.db")
    database.prepare()
    with closing(database.open_writer()) as connection:
        with pytest.raises(KeyError), translated(connection):
            raise KeyError("ours")
        with pytest.raises(exc.OperationalError, match="locked"), translated(connection):
            raise sqlite3.OperationalError("database is locked")
    database.dispose()
