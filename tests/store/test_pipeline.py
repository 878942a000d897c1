"""What is sent to PostgreSQL together comes back as it was, in its order, and fails as one."""

from __future__ import annotations

from collections.abc import Iterator

import psycopg
import pytest
from psycopg.errors import UniqueViolation
from tests.freezing import frozen

from robomend.store.bounded import BoundedConnection
from robomend.store.pipeline import Pipeline

NAMES = ["plain", 'a "quoted" one', "back\\slash", "{brace},comma", "ünïcödé", "", "NULL", " "]


@pytest.fixture
def connection(postgres_url: str) -> Iterator[BoundedConnection]:
    with BoundedConnection.connect(postgres_url) as found:
        found.execute("CREATE TABLE kept (name text PRIMARY KEY, number bigint, sure boolean, raw bytea)")
        found.commit()
        found.prepare_threshold = None
        yield found
        found.close()


@pytest.fixture
def pipeline(connection: psycopg.Connection) -> Pipeline:
    return Pipeline(connection)


def names(connection: psycopg.Connection) -> list[str]:
    return [name for (name,) in connection.execute("SELECT name FROM kept ORDER BY name").fetchall()]


def test_values_come_back_as_they_were(connection: psycopg.Connection, pipeline: Pipeline) -> None:
    rows = [
        (name, number, sure)
        for name, number, sure in zip(
            NAMES, [0, -1, 2**62, None] * 2, [True, False, None, True] * 2, strict=True
        )
    ]
    for row in rows:
        pipeline.send("INSERT INTO kept (name, number, sure) VALUES ($1, $2, $3)", row)
    found = pipeline.send("SELECT name, number, sure FROM kept WHERE name = ANY($1)", [NAMES])
    assert sorted(found.fetchall(), key=repr) == sorted(rows, key=repr)
    assert found.fetchall() == []
    assert found.fetchone() is None
    raw = pipeline.send("UPDATE kept SET raw = '\\x00ff5c' WHERE name = $1 RETURNING raw", ["plain"])
    assert raw.fetchone() == (b"\x00\xff\\",)
    by_raw = pipeline.send("SELECT name FROM kept WHERE raw = ANY($1)", [[b"\x00\xff\\", b""]])
    assert by_raw.fetchall() == [("plain",)]
    assert connection.info.transaction_status == psycopg.pq.TransactionStatus.INTRANS
    pipeline.send("COMMIT")
    pipeline.wait()
    assert names(connection) == sorted(NAMES)


def test_the_first_error_counts_and_nothing_behind_it_is_done(
    connection: psycopg.Connection, pipeline: Pipeline
) -> None:
    keep = "INSERT INTO kept (name) VALUES ($1)"
    for _ in range(2):  # what was to be prepared behind the error is prepared the second time
        pipeline.send(keep, ["one"])
        pipeline.send(keep, ["one"])
        behind = pipeline.send("SELECT count(*) FROM kept")
        pipeline.send("COMMIT")
        with pytest.raises(UniqueViolation):
            pipeline.wait()
        assert pipeline.empty
        assert behind.fetchall() == []
        connection.rollback()
        assert names(connection) == []
        connection.rollback()
    pipeline.send(keep, ["two"])
    pipeline.send("COMMIT")
    pipeline.wait()
    assert names(connection) == ["two"]
    prepared = connection.execute("SELECT statement FROM pg_prepared_statements").fetchall()
    assert len(prepared) == len(set(prepared)), "what failed leaves nothing behind that is prepared again"


def test_the_drivers_own_statements_go_between(connection: psycopg.Connection, pipeline: Pipeline) -> None:
    for number in range(8):  # more often than the driver sends a statement unprepared
        pipeline.send("INSERT INTO kept (name, number) VALUES ($1, $2)", [f"ours {number}", number])
        pipeline.wait()
        connection.execute("SAVEPOINT one")
        connection.execute("INSERT INTO kept (name, number) VALUES (%s, %s)", [f"its {number}", number])
        if number % 2:
            connection.execute("ROLLBACK TO SAVEPOINT one")
    connection.commit()
    assert names(connection) == [*(f"its {n}" for n in range(0, 8, 2)), *(f"ours {n}" for n in range(8))]


def test_more_than_fits_on_the_way_is_sent_while_answers_are_read(
    connection: psycopg.Connection, pipeline: Pipeline
) -> None:
    """Where nobody read the answers before all was sent, both sides would wait for each other for ever."""
    text, count = "x" * 20_000, 1_000
    answers = [pipeline.send("SELECT $1 || $2", [text, str(number)]) for number in range(count)]
    pipeline.wait()
    assert [answer.fetchall() for answer in answers] == [[(f"{text}{number}",)] for number in range(count)]


def test_a_connection_that_ends_meanwhile_is_lost(
    connection: psycopg.Connection, pipeline: Pipeline, postgres_url: str
) -> None:
    with psycopg.connect(postgres_url, autocommit=True) as other:
        pipeline.send("INSERT INTO kept (name) VALUES ($1)", ["lost"])
        other.execute("SELECT pg_terminate_backend(%s)", [connection.info.backend_pid])
        pipeline.send("COMMIT")
        with pytest.raises(psycopg.OperationalError):
            pipeline.wait()
        assert connection.closed
        assert names(other) == []


def test_a_server_that_says_nothing_is_not_waited_for_without_end(
    connection: BoundedConnection, pipeline: Pipeline
) -> None:
    connection.answer_s = 0.3
    with frozen(connection.info.backend_pid):
        pipeline.send("INSERT INTO kept (name) VALUES ($1)", ["unheard"])
        with pytest.raises(psycopg.OperationalError, match=r"nothing for 0\.3 s"):
            pipeline.wait()
        assert connection.closed


def test_what_is_no_value_of_a_statement_is_refused_before_it_is_sent(
    connection: psycopg.Connection, pipeline: Pipeline
) -> None:
    pipeline.send("INSERT INTO kept (name) VALUES ($1)", ["one"])
    with pytest.raises(TypeError, match="float"):
        pipeline.send("SELECT $1", [1.5])
    pipeline.send("COMMIT")
    pipeline.wait()
    assert names(connection) == ["one"]
