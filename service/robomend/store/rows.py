"""Rows that wait in memory until their group's end, and how a row is put in.

A row is a tuple in the order of its columns, which stand here.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

from sqlalchemy import Insert, Table
from sqlalchemy.dialects import postgresql, sqlite

from robomend.store.encoding import Encoded, to_json
from robomend.store.records import Json
from robomend_client.events import Kind

Values = dict[str, Any]
Row = tuple[Any, ...]

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
        self.obs: dict[tuple[str, str], Row] = {}  # that are not taken from the log
        self.once: dict[str, Row] = {}  # digest of a key -> digest of the request, answer, expiry
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
