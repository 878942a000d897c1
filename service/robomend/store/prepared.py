"""Statements that every group of changes runs: put into the database's words once, and handed to its driver.

SQLAlchemy takes several times as long for each execution as SQLite does: it looks the statement up, turns its
values and wraps what comes back. Nothing of that is needed where the statement never changes. Errors are
those that SQLAlchemy would have raised, so that whoever handles them need not know.

SQLite's driver lets the interpreter's lock go for each row of `executemany`, and must get it back from the
event loop each time. So rows go to SQLite many in one statement:

    INSERT … VALUES (?, ?)   ──►   INSERT … VALUES (?, ?), (?, ?), … (64, 32, 16, 8, 4, 2 or 1 at a time)
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import chain
from operator import itemgetter
from typing import Any

from sqlalchemy import Connection, Executable, exc
from sqlalchemy.sql.compiler import SQLCompiler

Values = Mapping[str, Any]

AT_ONCE = 64
"""Rows in one statement of SQLite: of so few different lengths that each stays prepared."""

_ROW = re.compile(r"VALUES (\([?, ]+\))")


@dataclass(frozen=True, slots=True)
class _Made:
    """A statement in the words of one kind of database."""

    text: str
    given: Callable[[Values], Any]  # a row as the driver takes it
    one: re.Match[str] | None  # the place of one row, where more rows fit into the statement


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
        self._made: dict[str, _Made] = {}
        self._longer: dict[int, str] = {}  # for more rows than one, on SQLite

    def run(self, connection: Connection, rows: Sequence[Values]) -> None:
        """Execute it for each row."""
        made = self._in_words(connection)
        try:
            self._run(driver_of(connection), made, [made.given(row) for row in rows])
        except connection.dialect.loaded_dbapi.Error as error:
            raise translation(connection, error) from error

    def _run(self, driver: Any, made: _Made, given: Sequence[Any]) -> None:
        if made.one is None:
            with closing(driver.cursor()) as cursor:
                cursor.executemany(made.text, given)
            return
        done = 0
        while left := len(given) - done:
            some = min(AT_ONCE, 1 << (left.bit_length() - 1))
            if some == 1:
                driver.execute(made.text, given[done])
            else:
                text = self._many(made.text, made.one, some)
                driver.execute(text, [*chain.from_iterable(given[done : done + some])])
            done += some

    def value(self, connection: Connection, row: Values) -> Any:
        """Execute it and return the first value of the first row that it returns."""
        made = self._in_words(connection)
        try:
            return driver_of(connection).execute(made.text, made.given(row)).fetchone()[0]
        except connection.dialect.loaded_dbapi.Error as error:
            raise translation(connection, error) from error

    def _many(self, text: str, one: re.Match[str], rows: int) -> str:
        """Return the statement for so many rows."""
        many = self._longer.get(rows)
        if many is None:
            more = f", {one[1]}" * (rows - 1)
            many = self._longer[rows] = f"{text[: one.end()]}{more}{text[one.end() :]}"
        return many

    def _in_words(self, connection: Connection) -> _Made:
        kind = connection.dialect.name
        made = self._made.get(kind)
        if made is None:
            statement = self._statement(kind)
            compiled = statement.compile(dialect=connection.dialect, column_keys=self._columns)  # type: ignore[attr-defined]  # every statement has it
            assert isinstance(compiled, SQLCompiler)
            names = compiled.positiontup if compiled.positional else None
            one = _ROW.search(str(compiled)) if kind == "sqlite" else None
            made = self._made[kind] = _Made(
                str(compiled), _as_it_is if names is None else _in_order(names), one
            )
        return made


def select_in(connection: Connection, texts: Mapping[str, str], keys: Sequence[Any]) -> list[tuple[Any, ...]]:
    """Return the rows of a query with `IN ({keys})` or, on PostgreSQL, `= ANY(%s)`."""
    text = texts[connection.dialect.name]
    sqlite = connection.dialect.name == "sqlite"
    values = tuple(keys) if sqlite else (list(keys),)
    if sqlite:
        text = text.format(keys=",".join("?" * len(keys)))
    try:
        found: list[tuple[Any, ...]] = driver_of(connection).execute(text, values).fetchall()
    except connection.dialect.loaded_dbapi.Error as error:
        raise translation(connection, error) from error
    return found


def driver_of(connection: Connection) -> Any:
    """Return the driver's own connection."""
    return connection.connection.driver_connection


def translation(connection: Connection, error: Any) -> exc.DBAPIError:
    """Return SQLAlchemy's error for a driver's; the connection knows then whether it is lost."""
    dialect = connection.dialect
    lost = dialect.is_disconnect(error, driver_of(connection), None)
    raised = exc.DBAPIError.instance(
        None, None, error, dialect.loaded_dbapi.Error, connection_invalidated=lost, dialect=dialect
    )
    if lost:
        connection.invalidate(error)
    assert isinstance(raised, exc.DBAPIError)
    return raised


def _as_it_is(row: Values) -> Values:
    return row


def _in_order(names: Sequence[str]) -> Callable[[Values], tuple[Any, ...]]:
    """Return what puts the values of a row in this order."""
    if len(names) == 1:
        [name] = names
        return lambda row: (row[name],)
    return itemgetter(*names)
