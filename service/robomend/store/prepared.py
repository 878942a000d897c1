"""Statements that every group of changes runs: put into the database's words once, and handed to its driver.

A statement that never changes need not be looked up each time, nor have its values turned (driver.py).

SQLite's driver lets the interpreter's lock go for each row of `executemany`, and must get it back from the
event loop each time. So rows go to SQLite many in one statement:

    INSERT … VALUES (?, ?)   ──►   INSERT … VALUES (?, ?), (?, ?), … (64, 32, 16, 8, 4, 2 or 1 at a time)
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain
from operator import itemgetter
from typing import Any

from sqlalchemy import Executable
from sqlalchemy.sql.compiler import SQLCompiler

from robomend.store.driver import DriverConnection

Row = Sequence[Any]
"""The values of a statement, in the order of its columns."""

AT_ONCE = 64
"""Rows in one statement of SQLite: of so few different lengths that each stays prepared."""

_BY_NAME = re.compile(r"%\((\w+)\)s")
_ROW = re.compile(r"VALUES (\([?, ]+\))")


@dataclass(frozen=True, slots=True)
class _Made:
    """A statement in the words of one kind of database."""

    text: str
    given: Callable[[Row], Any] | None  # a row as the driver takes it; None: as it is
    one: re.Match[str] | None  # the place of one row, where more rows fit into the statement


class Prepared:
    """A statement for rows of values, which are taken as they are: no column's type converts them."""

    def __init__(self, statement: Callable[[str], Executable], columns: Sequence[str]) -> None:
        """Prepare nothing yet.

        Args:
            statement: makes it, for a kind of database.
            columns: names of the values, in the order in which a row has them.
        """
        self._statement = statement
        self._columns = tuple(columns)
        self._made: dict[str, _Made] = {}
        self._longer: dict[int, str] = {}  # for more rows than one, on SQLite

    def run(self, driver: DriverConnection, rows: Sequence[Row]) -> None:
        """Execute it for each row."""
        made = self._made.get(driver.kind) or self._in_words(driver)
        if driver.kind == "postgresql":
            driver.execute_many(made.text, rows)
            return
        given: Sequence[Any] = rows if made.given is None else [made.given(row) for row in rows]
        try:
            if len(given) == 1:
                driver.itself.execute(made.text, given[0])
            else:
                self._run(driver.itself, made, given)
        except driver.error as error:
            raise driver.translation(error) from error

    def value(self, driver: DriverConnection, row: Row) -> Any:
        """Execute it and return the first value of the first row that it returns."""
        return self.later(driver, row)()

    def later(self, driver: DriverConnection, row: Row) -> Callable[[], Any]:
        """Execute it, and return what returns that value; that waits for it, after `together`."""
        made = self._made.get(driver.kind) or self._in_words(driver)
        cursor = driver.execute(made.text, row if made.given is None else made.given(row))
        return lambda: cursor.fetchone()[0]

    def rows(self, driver: DriverConnection, row: Row) -> Callable[[], list[Any]]:
        """Execute it, and return what returns the rows that it finds, as `later`."""
        made = self._made.get(driver.kind) or self._in_words(driver)
        cursor = driver.execute(made.text, row if made.given is None else made.given(row))
        found: Callable[[], list[Any]] = cursor.fetchall
        return found

    def _run(self, itself: Any, made: _Made, given: Sequence[Any]) -> None:
        if made.one is None:
            itself.executemany(made.text, given)
            return
        done = 0
        while left := len(given) - done:
            some = min(AT_ONCE, 1 << (left.bit_length() - 1))
            if some == 1:
                itself.execute(made.text, given[done])
            else:
                text = self._many(made.text, made.one, some)
                itself.execute(text, [*chain.from_iterable(given[done : done + some])])
            done += some

    def _many(self, text: str, one: re.Match[str], rows: int) -> str:
        """Return the statement for so many rows."""
        many = self._longer.get(rows)
        if many is None:
            more = f", {one[1]}" * (rows - 1)
            many = self._longer[rows] = f"{text[: one.end()]}{more}{text[one.end() :]}"
        return many

    def _in_words(self, driver: DriverConnection) -> _Made:
        statement = self._statement(driver.kind)
        dialect = driver.connection.dialect
        compiled = statement.compile(dialect=dialect, column_keys=list(self._columns))  # type: ignore[attr-defined]  # every statement has it
        assert isinstance(compiled, SQLCompiler)
        if driver.kind == "postgresql":
            words = _BY_NAME.sub(lambda found: f"${self._columns.index(found[1]) + 1}", str(compiled))
            made = _Made(words.replace("%%", "%"), None, None)
        else:
            assert compiled.positiontup is not None
            made = _Made(str(compiled), self._given(compiled.positiontup), _ROW.search(str(compiled)))
        self._made[driver.kind] = made
        return made

    def _given(self, order: Sequence[str]) -> Callable[[Row], Any] | None:
        """Return what puts the values of a row in this order."""
        if tuple(order) == self._columns:
            return None
        places = [self._columns.index(name) for name in order]
        return (lambda row: (row[places[0]],)) if len(places) == 1 else itemgetter(*places)
