"""Rows that wait in memory until their group's end, and how a row is put in."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from typing import Any, NamedTuple

from sqlalchemy import Insert, Table
from sqlalchemy.dialects import postgresql, sqlite

from robomend.store.encoding import Encoded, to_json
from robomend.store.records import Json
from robomend_client.events import Kind

Values = dict[str, Any]


class LockedRobot(NamedTuple):
    """The locked row of a robot."""

    revision: int
    fence: int
    owner: str | None
    exists: bool


@dataclass(slots=True)
class Rows:
    """Rows that wait in memory, and what is known of the locked robots."""

    states: dict[str, LockedRobot] = field(default_factory=dict)
    revised: set[str] = field(default_factory=set)
    history: list[Values] = field(default_factory=list)
    obs: dict[tuple[str, str], Values | None] = field(default_factory=dict)  # None: forgotten
    once: dict[tuple[str, str], Values] = field(default_factory=dict)
    diagnoses: list[Values] = field(default_factory=list)
    audit: list[Values] = field(default_factory=list)
    events: list[tuple[Kind, str | None, Json, Values]] = field(default_factory=list)
    common: dict[str, str] = field(default_factory=dict)  # digest -> text, of what the rows above have
    turn: bool = False  # somebody asks only whether there is a turn to write

    def absorb(self, other: Rows) -> None:
        """Take over the rows of a change that went well."""
        self.states.update(other.states)
        self.revised |= other.revised
        self.history += other.history
        self.obs.update(other.obs)
        self.once.update(other.once)
        self.diagnoses += other.diagnoses
        self.audit += other.audit
        self.events += other.events
        self.common.update(other.common)
        self.turn |= other.turn

    def kept(self, column: str, data: Json) -> Values:
        """Return the columns that keep a value; in place of its result's number stands the digest yet."""
        if type(data) is Encoded and data.common is not None:
            self.common[data.common.digest] = data.common.text
            return {column: data.own, "common": data.common.digest}
        return {column: to_json(data), "common": None}


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
