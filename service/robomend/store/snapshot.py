"""A snapshot of the database: how questions are put to it, and how their answers are cut into pages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from sqlalchemy import Connection, Row, Select, Table, select

from robomend.errors import InputError, NotFound
from robomend.store.records import Page, Paging

T = TypeVar("T")
AnyRow = Row[Any]

MAX_PAGE = 1000


class DatabaseSnapshot:
    """What both halves of the view stand on."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    @property
    def connection(self) -> Connection:
        """The connection, in its transaction."""
        return self._connection

    def rows(self, query: Select[Any]) -> list[AnyRow]:
        """Every question goes through here; a transaction first puts its own writes where they are seen."""
        return list(self._connection.execute(query))

    def _first(self, query: Select[Any]) -> AnyRow | None:
        rows = self.rows(query.limit(1))
        return rows[0] if rows else None

    def _one(self, query: Select[Any], what: str) -> AnyRow:
        row = self._first(query)
        if row is None:
            raise NotFound(f"there is no {what}")
        return row

    def _newest_first(
        self, table: Table, make: Callable[[AnyRow], T], paging: Paging, *where: Any, key: str = "number"
    ) -> Page[T]:
        """Return a page in the order of a numeric key, largest first; the cursor is the last one seen."""
        column = table.c[key]
        query = select(table).where(*where).order_by(column.desc()).limit(limit_of(paging) + 1)
        if paging.cursor is not None:
            query = query.where(column < _number(paging.cursor))
        return page_of(self.rows(query), paging, make, lambda row: str(row._mapping[key]))


def limit_of(paging: Paging) -> int:
    """Return the size of the page; InputError outside 1 to 1000."""
    if not 1 <= paging.limit <= MAX_PAGE:
        raise InputError(f"a page holds 1 to {MAX_PAGE} entries, not {paging.limit}")
    return paging.limit


def page_of(
    rows: list[AnyRow], paging: Paging, make: Callable[[AnyRow], T], cursor: Callable[[AnyRow], str]
) -> Page[T]:
    """Return the page of rows that were read with one more than fits, to know whether there is a next."""
    more = len(rows) > paging.limit
    rows = rows[: paging.limit]
    return Page(tuple(make(row) for row in rows), cursor(rows[-1]) if more else None)


def _number(cursor: str) -> int:
    if cursor.isascii() and cursor.isdecimal() and len(cursor) <= 18:
        return int(cursor)
    raise InputError(f"{cursor[:40]!a} is no cursor of this list; use the one that came as `next`")
