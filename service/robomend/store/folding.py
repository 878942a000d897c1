"""OBS as it is kept: rows, and the batches of the log that came since.

    rows of `obs`, with all batches up to revision N ──┐
    batches N+1, N+2, … of the log (few) ──────────────┴─ in their order ──► OBS now

Writing OBS with each batch would cost as much again as the batch itself. So only every EVERY-th batch of a
robot brings the rows up to the log, and whoever reads OBS folds in the few batches that are not in them yet.
Which batches these are goes by the robot's name as well: robots that began together do not write together.

Written at once are large batches, which would be read again and again, and renewals, which are in no batch.
Such a row carries the revision that it is of; a batch of the log that is not newer leaves it as it is.

A robot's revision is the newest that the log has of it. On PostgreSQL its row, which is locked for each group
in any case, has it too.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any
from zlib import crc32

from sqlalchemy import ColumnElement, Connection, bindparam, select, text

from robomend.entry import Entry
from robomend.store import schema
from robomend.store.encoding import (
    INT64,
    atom_from_text,
    atom_to_text,
    checked,
    checked_ns,
    entry_of,
    from_json,
    held_of,
    more_of,
)
from robomend.store.records import StoredObs
from robomend.store.rows import BATCHES, OBS, AnyRow, Columns, View, upsert
from robomend_client.literals import Literal

EVERY = 64
"""Batches of a robot between two of its rows being brought up to the log."""

LARGE = 64
"""Entries of a batch that is written to the rows at once."""

_STATES, _OBS, _LOG = schema.robot_state, schema.obs, schema.events


def newest_batches(robot: ColumnElement[str]) -> tuple[ColumnElement[Any], ...]:
    """Return the columns of a query of `robot_state` that `newest` reads, beside its revision."""

    def newest_of(kind: str) -> ColumnElement[Any]:
        of_robot = select(_LOG.c.revision).where(_LOG.c.robot == robot, _LOG.c.kind == kind)
        return of_robot.order_by(_LOG.c.id.desc()).limit(1).scalar_subquery().label(kind)

    return tuple(newest_of(kind) for kind in BATCHES)


def newest(row: AnyRow) -> int:
    """Return the revision that a robot is at, of a row with `revision` and `newest_batches`."""
    return int(max(row.revision, *(row._mapping[kind] or 0 for kind in BATCHES)))


_STATE = select(_STATES.c.revision, _STATES.c.folded, *newest_batches(_STATES.c.robot)).where(
    _STATES.c.robot == bindparam("of_robot")
)
_HELD = select(_OBS).where(_OBS.c.robot == bindparam("of_robot")).order_by(_OBS.c.atom)
_BATCHES = text(
    " UNION ALL ".join(
        "SELECT revision, batch FROM (SELECT revision, batch FROM events"
        f" WHERE robot = :of_robot AND kind = '{kind}' ORDER BY id DESC"
        " LIMIT (SELECT :revision - folded FROM robot_state WHERE robot = :of_robot)"
        f") AS {kind} WHERE revision > (SELECT folded FROM robot_state WHERE robot = :of_robot)"
        for kind in BATCHES
    )
)
"""Those that are in the log only, of a robot that is at :revision."""

_NEWER = text(
    "SELECT atom, revision FROM obs WHERE robot = :of_robot"
    " AND revision > (SELECT folded FROM robot_state WHERE robot = :of_robot)"
)
_FORGET = _OBS.delete().where(_OBS.c.robot == bindparam("of_robot"), _OBS.c.atom == bindparam("of_atom"))
_FOLDED = (
    _STATES.update()
    .where(_STATES.c.robot == bindparam("of_robot"))
    .values(revision=bindparam("to"), folded=bindparam("to"))
)


def due(robot: str, revision: int) -> bool:
    """Return whether the batch that made this revision brings the robot's rows up to the log."""
    return (revision + crc32(robot.encode())) % EVERY == 0


def obs_row(robot: str, entry: Entry, revision: int) -> Columns:
    """Return the row of an entry that OBS holds since a revision. InputError: no column takes it."""
    atom, positive = entry.literal
    times = (entry.time_ns, entry.expires_ns, entry.since_ns, entry.onset_ns, entry.settled)
    for time_ns in times:
        if time_ns is not None and time_ns not in INT64:
            checked_ns(time_ns)
    return (robot, atom_to_text(atom), positive, checked(entry.source), *times, more_of(entry), revision)


def revision(view: View, robot: str) -> int:
    """Return the revision that a robot is at; 0 for an unknown one."""
    states = view.of_log(_STATE, {"of_robot": checked(robot)})
    return newest(states[0]) if states else 0


def obs(view: View, robot: str) -> StoredObs:
    """Return OBS now, without its assertions, expired entries included."""
    states = view.of_log(_STATE, {"of_robot": checked(robot)})
    if not states:
        return StoredObs(0)
    revision = newest(states[0])
    held: dict[str, Columns] = {row.atom: tuple(row) for row in view.rows(_HELD, {"of_robot": robot})}
    if revision > states[0].folded:
        batches = view.of_log(_BATCHES, {"of_robot": robot, "revision": revision})
        for atom, folded in fold(robot, {atom: row[-1] for atom, row in held.items()}, batches).items():
            if folded is None:
                held.pop(atom, None)
            else:
                held[atom] = folded
    return StoredObs(revision, tuple(_entry(held[atom]) for atom in sorted(held)))


def bring_up(connection: Connection, robot: str, revision: int) -> None:
    """Bring a robot's rows up to the log, which has all batches up to this revision, in a transaction."""
    newer = {row.atom: row.revision for row in connection.execute(_NEWER, {"of_robot": robot})}
    batches = connection.execute(_BATCHES, {"of_robot": robot, "revision": revision})
    rows = fold(robot, newer, [(row.revision, row.batch) for row in batches])
    kept = [dict(zip(OBS, row, strict=True)) for row in rows.values() if row is not None]
    if kept:
        connection.execute(upsert(connection.dialect.name, _OBS), kept)
    gone = [{"of_robot": robot, "of_atom": atom} for atom, row in rows.items() if row is None]
    if gone:
        connection.execute(_FORGET, gone)
    connection.execute(_FOLDED, {"of_robot": robot, "to": revision})


def fold(robot: str, of: Mapping[str, int], batches: Iterable[Sequence[Any]]) -> dict[str, Columns | None]:
    """Return the rows that batches of the log change, None for one that is to go.

    Args:
        of: atoms -> the revision that their rows are of, of those at least that no batch was folded into.
        batches: revision and text of each.
    """
    rows: dict[str, Columns | None] = {}
    for revision, batch in sorted((revision, batch) for revision, batch in batches):
        held, forgotten = held_of(batch)
        for atom, columns in held:
            if of.get(atom, 0) < revision:
                rows[atom] = (robot, atom, *columns, revision)
        for atom in forgotten:  # after it held what it holds
            if of.get(atom, 0) <= revision:
                rows[atom] = None
    return rows


def _entry(row: Columns) -> Entry:
    _, atom, positive, *columns, more, _ = row
    columns.append(None if more is None else from_json(more))
    return entry_of(Literal(atom_from_text(atom), bool(positive)), *columns)
