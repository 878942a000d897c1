"""Rows that wait in memory until their group's end, and how a row is put in.

A row is a tuple in the order of its columns, as it goes to the driver; the columns stand here.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

from sqlalchemy import Insert, Table
from sqlalchemy.dialects import postgresql, sqlite

from robomend.store.encoding import Encoded, to_json
from robomend.store.records import Json
from robomend_client.events import Kind

Values = dict[str, Any]
Row = tuple[Any, ...]

HISTORY = ("robot", "revision", "time_ns", "data")
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
)
DIAGNOSES = ("robot", "revision", "model_version", "time_ns", "result", "common")
EVENTS = ("id", "time_ns", "kind", "robot", "data", "common")


class LockedRobot(NamedTuple):
    """The locked row of a robot."""

    revision: int
    fence: int
    owner: str | None
    exists: bool


class Rows:
    """Rows that wait in memory, and what is known of the locked robots."""

    __slots__ = (
        "audit",
        "common",
        "diagnoses",
        "events",
        "history",
        "obs",
        "once",
        "revised",
        "states",
        "turn",
    )

    def __init__(self) -> None:
        self.states: dict[str, LockedRobot] = {}
        self.revised: set[str] = set()
        self.history: list[Row] = []
        self.obs: dict[tuple[str, str], Row | None] = {}  # None: forgotten
        self.once: dict[tuple[str, str], Values] = {}
        self.diagnoses: list[Row] = []  # in place of a result's number stands its digest yet
        self.audit: list[Values] = []
        self.events: list[tuple[Kind, str | None, Json, str, str | None]] = []  # text and digest of the data
        self.common: dict[str, str] = {}  # digest -> text, of what the rows above have
        self.turn = False  # somebody asks only whether there is a turn to write

    def absorb(self, other: Rows) -> None:
        """Take over the rows of a change that went well."""
        self.states |= other.states
        self.revised |= other.revised
        self.history += other.history
        self.obs |= other.obs
        self.once |= other.once
        self.diagnoses += other.diagnoses
        self.audit += other.audit
        self.events += other.events
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
