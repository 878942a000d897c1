"""What is handed to the driver directly fails as what goes through SQLAlchemy does."""

from __future__ import annotations

import uuid
from contextlib import closing

import psycopg
import pytest
from sqlalchemy import exc, select
from tests.postgres import PostgresServer

from robomend.store import schema
from robomend.store.database import BUSY_TIMEOUT_S, Database
from robomend.store.driver import DriverConnection
from robomend.store.prepared import Prepared

COUNTERS = Prepared(lambda _: schema.counters.insert(), ["name", "value"])


def test_rows_are_written_and_a_refused_one_is_sqlalchemys_error(url: str) -> None:
    database = Database(url)
    database.prepare()
    with closing(database.open_writer()) as connection:
        with connection.begin():
            COUNTERS.run(DriverConnection(connection), [("a", 1), ("b", 2**40)])
        with pytest.raises(exc.IntegrityError) as refused, connection.begin():
            COUNTERS.run(DriverConnection(connection), [("c", 3), ("a", 3)])
        assert not refused.value.connection_invalidated
        rows = connection.execute(select(schema.counters).order_by(schema.counters.c.name)).all()
        assert [tuple(row) for row in rows] == [("a", 1), ("audit", 0), ("b", 2**40), ("event", 0)]
    database.dispose()


def test_a_lost_connection_is_known_as_lost(postgres_url: str) -> None:
    database = Database(postgres_url)
    database.prepare()
    driver = database.open_driver()
    database.begin(driver)
    with psycopg.connect(postgres_url, autocommit=True) as other:
        other.execute("SELECT pg_terminate_backend(%s)", [driver.itself.info.backend_pid])
    with pytest.raises(exc.DBAPIError) as lost:
        COUNTERS.run(driver, [("a", 1)])
    assert lost.value.connection_invalidated
    assert driver.connection.invalidated
    database.dispose()


@pytest.mark.parametrize("count", [1, 2, 3, 63, 64, 65, 200])
def test_any_number_of_rows_is_written_once_each(url: str, count: int) -> None:
    database = Database(url)
    database.prepare()
    names = [f"row {number:03}" for number in range(count)]
    with closing(database.open_writer()) as connection, connection.begin():
        COUNTERS.run(DriverConnection(connection), [(name, number) for number, name in enumerate(names)])
        rows = connection.execute(select(schema.counters).order_by(schema.counters.c.name)).all()
        assert [tuple(row) for row in rows if row.name in names] == [*zip(names, range(count), strict=True)]
        assert len(rows) == count + 2
    database.dispose()


def test_a_driver_that_finds_the_database_locked_says_so_in_sqlalchemys_words(tmp_path: object) -> None:
    database = Database(f"sqlite:///{tmp_path}/robomend.db")
    database.prepare()
    with closing(database.open_writer()) as one, closing(database.open_writer()) as other, one.begin():
        COUNTERS.run(DriverConnection(one), [("a", 1)])
        DriverConnection(other).execute("PRAGMA busy_timeout=0")
        with pytest.raises(exc.OperationalError, match="locked") as locked:
            COUNTERS.run(DriverConnection(other), [("b", 1)])
        assert not locked.value.connection_invalidated
    database.dispose()


def test_a_writers_connection_waits_again_when_it_is_a_readers(tmp_path: object) -> None:
    database = Database(f"sqlite:///{tmp_path}/robomend.db")
    database.prepare()
    with closing(database.open_writer()) as writer:
        with writer.begin():
            assert writer.exec_driver_sql("PRAGMA busy_timeout").scalar() == 0
        used = DriverConnection(writer).itself
    with database.reading() as reader:
        assert DriverConnection(reader).itself is used
        assert reader.exec_driver_sql("PRAGMA busy_timeout").scalar() == BUSY_TIMEOUT_S * 1000
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
        COUNTERS.run(DriverConnection(connection), [("Žižka", 1)])
        found = connection.execute(select(schema.counters.c.name)).scalars().all()
    database.dispose()
    with psycopg.connect(postgres_url, autocommit=True) as admin:
        admin.execute(f"DROP DATABASE {name} WITH (FORCE)")
    assert "Žižka" in found
