"""Statements that every group of changes runs: put into the database's words once, and handed to its driver.

SQLAlchemy takes several times as long for each execution as SQLite does: it looks the statement up, turns its
values and wraps what comes back. Nothing of that is needed where the statement never changes. Errors are
those that SQLAlchemy would have raised, so that whoever handles them need not know.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from typing import Any

from sqlalchemy import Connection, Executable, exc
from sqlalchemy.sql.compiler import SQLCompiler

Values = Mapping[str, Any]


class Prepared:
    """A statement for rows of values, which are taken as they are: no column's type converts them."""

    def __init__(self, statement: Callable[[str], Executable], columns: Sequence[str] | None = None) -> None:
        """Prepare nothing yet.

        Args:
            statement: makes it, for a kind of database.
            columns: of an insert.
        """
        self._statement = statement
        self._columns = None if columns is None else list(columns)
        self._made: dict[str, tuple[str, Sequence[str] | None]] = {}

    def run(self, connection: Connection, rows: Sequence[Values]) -> None:
        """Execute it for each row."""
        text, names = self._text(connection)
        driver = driver_of(connection)
        with translated(connection), closing(driver.cursor()) as cursor:
            cursor.executemany(text, [_given(names, row) for row in rows])

    def value(self, connection: Connection, row: Values) -> Any:
        """Execute it and return the first value of the first row that it returns."""
        text, names = self._text(connection)
        with translated(connection), closing(driver_of(connection).cursor()) as cursor:
            return cursor.execute(text, _given(names, row)).fetchone()[0]

    def _text(self, connection: Connection) -> tuple[str, Sequence[str] | None]:
        kind = connection.dialect.name
        made = self._made.get(kind)
        if made is None:
            statement = self._statement(kind)
            compiled = statement.compile(dialect=connection.dialect, column_keys=self._columns)  # type: ignore[attr-defined]  # every statement has it
            assert isinstance(compiled, SQLCompiler)
            names = compiled.positiontup if compiled.positional else None
            made = self._made[kind] = (str(compiled), names)
        return made


def select_in(connection: Connection, texts: Mapping[str, str], keys: Sequence[Any]) -> list[tuple[Any, ...]]:
    """Return the rows of a query with `IN ({keys})` or, on PostgreSQL, `= ANY(%s)`."""
    text = texts[connection.dialect.name]
    sqlite = connection.dialect.name == "sqlite"
    values = tuple(keys) if sqlite else (list(keys),)
    with translated(connection), closing(driver_of(connection).cursor()) as cursor:
        cursor.execute(text.format(keys=",".join("?" * len(keys))) if sqlite else text, values)
        found: list[tuple[Any, ...]] = cursor.fetchall()
        return found


def driver_of(connection: Connection) -> Any:
    """Return the driver's own connection."""
    return connection.connection.driver_connection


@contextmanager
def translated(connection: Connection) -> Iterator[None]:
    """Turn a driver's error into SQLAlchemy's, which knows whether the connection is lost."""
    dialect = connection.dialect
    errors = dialect.loaded_dbapi.Error
    try:
        yield
    except errors as error:
        lost = dialect.is_disconnect(error, driver_of(connection), None)
        raised = exc.DBAPIError.instance(
            None, None, error, errors, connection_invalidated=lost, dialect=dialect
        )
        if lost:
            connection.invalidate(error)
        raise raised from error


def _given(names: Sequence[str] | None, row: Values) -> Any:
    return row if names is None else tuple([row[name] for name in names])
