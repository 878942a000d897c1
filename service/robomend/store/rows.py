"""Rows of the database: how queries read them (`View`), how they wait in memory until their group's end
(`Rows`), and what rows of the log share (the table `results`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple, TypeVar

from sqlalchemy import (
    ColumnElement,
    Connection,
    Executable,
    Insert,
    Row,
    Select,
    Table,
    bindparam,
    func,
    select,
)
from sqlalchemy.dialects import postgresql, sqlite

from robomend.errors import InputError, NotFound, StoreError
from robomend.store import schema
from robomend.store.encoding import Encoded, checked, checked_ns, filled, to_json
from robomend.store.records import Json, Page, Paging
from robomend_client.events import Kind

# --- what a query reads: one snapshot of the database, in which everything is that was written before.
# The functions of the subjects (models.py, robots.py, …) take a View and return records.

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


# --- rows that wait: each is a tuple in the order of its columns, which stand here

Values = dict[str, Any]
Columns = tuple[Any, ...]

LOG = ("id", "time_ns", "kind", "robot", "revision", "batch", "data", "common")
OBS = (
    "robot",
    "atom",
    "positive",
    "source",
    "time_ns",
    "expires_ns",
    "since_ns",
    "onset_ns",
    "settled",
    "more",
    "revision",
)

ONCE = ("digest", "request", "response", "expires_ns")

OBSERVED, DIAGNOSED = str(Kind.OBSERVATIONS), str(Kind.DIAGNOSIS)
CHANGE = "change"
"""The kind of a row that is a batch and its diagnosis, and two events."""
BATCHES = (OBSERVED, CHANGE)
DIAGNOSES = (DIAGNOSED, CHANGE)


@dataclass(slots=True)
class Logged:
    """A row of the log that waits for its id, and the events that it is."""

    kind: str
    robot: str | None
    revision: int | None
    batch: str | None
    data: str | None
    digest: str | None  # of the result that has the rest of the data
    told: tuple[tuple[Kind, Json], ...]

    def is_batch(self, robot: str, revision: int) -> bool:
        """Return whether it is the batch of this revision, and no more."""
        return self.kind == OBSERVED and self.robot == robot and self.revision == revision

    def diagnosed(self, own: str, digest: str | None, told: tuple[tuple[Kind, Json], ...]) -> None:
        """Become the row of the batch that it is and of its diagnosis."""
        self.kind, self.data, self.digest = CHANGE, own, digest
        self.told += told


NEWEST_EVENT = (
    "SELECT max(value, coalesce((SELECT max(id) FROM events), 0)) FROM counters WHERE name = 'event'"
)
"""Of SQLite's: returns the id of the newest event. The counter is brought up to it when rows are removed."""


class LockedRobot(NamedTuple):
    """The locked row of a robot."""

    revision: int
    fence: int
    owner: str | None
    exists: bool


class Rows:
    """Rows that wait in memory, and what is known of the locked robots."""

    __slots__ = ("audit", "common", "folding", "log", "obs", "once", "revised", "states", "turn")

    def __init__(self) -> None:
        self.states: dict[str, LockedRobot] = {}
        self.revised: set[str] = set()
        self.folding: set[str] = set()  # robots of which OBS is to be brought up to the log
        self.log: list[Logged] = []
        self.obs: dict[tuple[str, str], Columns] = {}  # that are not taken from the log
        self.once: dict[str, Columns] = {}  # digest of a key -> digest of the request, answer, expiry
        self.audit: list[Values] = []
        self.common: dict[str, str] = {}  # digest -> text, of what rows of the log have
        self.turn = False  # somebody asks only whether there is a turn to write

    def absorb(self, other: Rows) -> None:
        """Take over the rows of a change that went well."""
        self.states |= other.states
        self.revised |= other.revised
        self.folding |= other.folding
        self.log += other.log
        self.obs |= other.obs
        self.once |= other.once
        self.audit += other.audit
        self.common |= other.common
        self.turn |= other.turn

    def kept(self, data: Json) -> tuple[str, str | None]:
        """Return the text that keeps a value, and the digest of the piece that other rows have as well."""
        if type(data) is not Encoded:
            return to_json(data), None
        if data.common is None:
            return data.text, None
        self.common[data.common.digest] = data.common.text
        return data.own, data.common.digest


@cache
def upsert(kind: str, table: Table) -> Insert:
    """Return the statement that inserts a row or replaces the one with its primary key."""
    keys = [column.name for column in table.primary_key]
    others = [column.name for column in table.columns if column.name not in keys]
    if kind == "sqlite":
        into_sqlite = sqlite.insert(table)
        return into_sqlite.on_conflict_do_update(keys, set_={n: into_sqlite.excluded[n] for n in others})
    into_postgres = postgresql.insert(table)
    replaced = {name: into_postgres.excluded[name] for name in others}
    return into_postgres.on_conflict_do_update(index_elements=keys, set_=replaced)


# --- what diagnoses say, once for all rows that say the same.
#
# Robots of one model meet each other's states, and a robot its own of before: of a diagnosis and its event,
# all but the revision and the time is a text that is in the table `results` already. The rows have its
# number.
#
# A result stays as long as a row may have its number: `used_day` is the latest day on which one was
# written, and grows only, whatever the clock does. Pruning (pruning.py) moves it on for rows that stay
# though they are old, and removes what was not used for longer than any row is kept.

DAY_NS = 86_400_000_000_000
_SOME = 500

_RESULTS = schema.results
_NEWEST_DAY = select(func.coalesce(func.max(_RESULTS.c.used_day), 0)).scalar_subquery()
_LOOK = select(_RESULTS.c.digest, _RESULTS.c.number, _RESULTS.c.used_day, _NEWEST_DAY.label("newest")).where(
    _RESULTS.c.digest.in_(bindparam("digests", expanding=True))
)
_TEXTS = select(_RESULTS.c.number, _RESULTS.c.data).where(
    _RESULTS.c.number.in_(bindparam("numbers", expanding=True))
)


def _keep(kind: str) -> Executable:
    """Return the statement that keeps a result, or says that it is used today; it returns the number."""
    insert: sqlite.Insert | postgresql.Insert = (
        sqlite.insert(_RESULTS) if kind == "sqlite" else postgresql.insert(_RESULTS)
    )
    later = func.max if kind == "sqlite" else func.greatest
    insert = insert.values(used_day=later(_NEWEST_DAY, bindparam("today")))
    used = {"used_day": later(_RESULTS.c.used_day, insert.excluded.used_day)}
    return insert.on_conflict_do_update(index_elements=["digest"], set_=used).returning(_RESULTS.c.number)


_KEEP = {kind: _keep(kind) for kind in ("sqlite", "postgresql")}


def numbers_of(connection: Connection, texts: Mapping[str, str], now_ns: int) -> dict[str, int]:
    """Return the number of each text, by its digest; what is not there yet is kept."""
    today = now_ns // DAY_NS
    numbers: dict[str, int] = {}
    digests = sorted(texts)  # one order, so that instances do not wait for each other in a circle
    for start in range(0, len(digests), _SOME):
        some = digests[start : start + _SOME]
        for row in connection.execute(_LOOK, {"digests": some}):
            if row.used_day >= max(today, row.newest):
                numbers[row.digest] = row.number
        for digest in some:
            if digest not in numbers:
                kept = {"digest": digest, "data": texts[digest], "today": today}
                numbers[digest] = connection.execute(_KEEP[connection.dialect.name], kept).scalar_one()
    return numbers


def texts_of(view: View, rows: Iterable[AnyRow]) -> Callable[[str, int | None], str]:
    """Return what makes the text of one of these rows, from what it keeps itself and its result's number."""
    numbers = sorted({row.common for row in rows if row.common is not None})
    found: dict[int, str] = {}
    for start in range(0, len(numbers), _SOME):
        some = numbers[start : start + _SOME]
        found.update((row.number, row.data) for row in view.rows(_TEXTS.params(numbers=some)))

    def whole(own: str, common: int | None) -> str:
        if common is None:
            return own
        if common not in found:
            raise StoreError(f"the result {common} of a diagnosis is missing in the database")
        return filled(own, found[common])

    return whole
