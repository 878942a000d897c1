"""What a query reads: one snapshot of the database, in which everything is that was written before.

The functions of the subjects (models.py, robots.py, …) take a View and return records.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from sqlalchemy import ColumnElement, Connection, Executable, Row, Select, Table, select

from robomend.errors import InputError, NotFound
from robomend.store import schema
from robomend.store.encoding import checked, checked_ns
from robomend.store.records import Page, Paging

T = TypeVar("T")
AnyRow = Row[Any]

MAX_PAGE = 1000


class View:
    """A consistent snapshot on a connection that is in a transaction."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    @property
    def connection(self) -> Connection:
        """The connection, in its transaction."""
        return self._connection

    def rows(self, query: Executable, values: Mapping[str, Any] | None = None) -> list[AnyRow]:
        """Every question goes through here; a transaction first puts its own writes where they are seen."""
        return list(self.connection.execute(query, values))

    def of_log(self, query: Executable, values: Mapping[str, Any] | None = None) -> list[AnyRow]:
        """As `rows`, about the log: a transaction, which writes that at its end, refuses it."""
        return self.rows(query, values)

    def first(self, query: Select[Any]) -> AnyRow | None:
        """Return the first row, if there is one."""
        rows = self.rows(query.limit(1))
        return rows[0] if rows else None

    def one(self, query: Select[Any], what: str) -> AnyRow:
        """Return the first row; NotFound if there is none, with `what` in its message."""
        row = self.first(query)
        if row is None:
            raise NotFound(f"there is no {what}")
        return row

    def newest_first(
        self, table: Table, make: Callable[[AnyRow], T], paging: Paging, *where: Any, key: str = "number"
    ) -> Page[T]:
        """Return a page in the order of a numeric key, largest first; the cursor is the last one seen."""
        return _page(self.rows(_newest(table, paging, where, key)), paging, make, key)

    def newest_of_log(
        self, robot: str, kinds: Sequence[str], make: Callable[[AnyRow], T], paging: Paging, *where: Any
    ) -> Page[T]:
        """Return a page of a robot's rows of some kinds, newest first."""
        of_robot = schema.events.c.robot == checked(robot)
        found: list[AnyRow] = []
        for kind in kinds:  # the index has them in their order, kind by kind
            of_kind = (of_robot, schema.events.c.kind == kind, *where)
            found += self.of_log(_newest(schema.events, paging, of_kind, "id"))
        found.sort(key=lambda row: row.id, reverse=True)
        return _page(found[: _limit(paging) + 1], paging, make, "id")

    def by_name(self, query: Select[Any], make: Callable[[AnyRow], T], paging: Paging, key: str) -> Page[T]:
        """Return a page of a query in the order of the column `key`, a text that is in it once."""
        column = query.selected_columns[key]
        query = query.order_by(column).limit(_limit(paging) + 1)
        if paging.cursor is not None:
            query = query.where(column > checked(paging.cursor))
        return _page(self.rows(query), paging, make, key)


def as_it_is(row: AnyRow) -> AnyRow:
    """Make nothing of a row."""
    return row


def _newest(table: Table, paging: Paging, where: Sequence[ColumnElement[bool]], key: str) -> Select[Any]:
    """Return the query of a page, and of one row more."""
    column = table.c[key]
    query = select(table).where(*where).order_by(column.desc()).limit(_limit(paging) + 1)
    if paging.cursor is not None:
        query = query.where(column < _number(paging.cursor))
    if paging.since_ns is not None or paging.until_ns is not None:
        time_ns = table.c.time_ns if "time_ns" in table.c else table.c.created_ns
        if paging.since_ns is not None:
            query = query.where(time_ns >= checked_ns(paging.since_ns))
        if paging.until_ns is not None:
            query = query.where(time_ns < checked_ns(paging.until_ns))
    return query


def _limit(paging: Paging) -> int:
    if not 1 <= paging.limit <= MAX_PAGE:
        raise InputError(f"a page holds 1 to {MAX_PAGE} entries, not {paging.limit}")
    return paging.limit


def _page(rows: list[AnyRow], paging: Paging, make: Callable[[AnyRow], T], key: str) -> Page[T]:
    """Return the page of rows that were read with one more than fits, to know whether there is a next."""
    more = len(rows) > paging.limit
    rows = rows[: paging.limit]
    return Page(tuple(make(row) for row in rows), str(rows[-1]._mapping[key]) if more else None)


def _number(cursor: str) -> int:
    if cursor.isascii() and cursor.isdecimal() and len(cursor) <= 18:
        return int(cursor)
    raise InputError(f"{cursor[:40]!a} is no cursor of this list; use the one that came as `next`")
