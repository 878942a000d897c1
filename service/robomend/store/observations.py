"""Observations: OBS as it is now, the named assertions, and the history of what was accepted."""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy import select

from robomend.entry import Entry
from robomend.errors import NotFound, StateConflict
from robomend.store import schema
from robomend.store.encoding import (
    INT64,
    atom_from_text,
    atom_to_text,
    batch_from_text,
    batch_to_text,
    checked,
    checked_ns,
)
from robomend.store.records import (
    FIRST_PAGE,
    Page,
    Paging,
    StoredAssertion,
    StoredBatch,
    StoredObs,
)
from robomend.store.rows import LockedRobot
from robomend.store.transaction import Transaction
from robomend.store.view import AnyRow, View
from robomend_client.literals import Atom, Literal


def revision(view: View, robot: str) -> int:
    """Return how many batches were accepted; 0 for an unknown robot."""
    table = schema.robot_state
    row = view.first(select(table.c.revision).where(table.c.robot == checked(robot)))
    return 0 if row is None else int(row.revision)


def obs(view: View, robot: str) -> StoredObs:
    """Return OBS now, expired entries included: freshness is judged by whoever reads it."""
    entries, assertions = schema.obs, schema.assertions
    return StoredObs(
        revision(view, robot),
        tuple(
            Entry(
                Literal(atom_from_text(row.atom), row.positive),
                row.source,
                row.time_ns,
                row.expires_ns,
                row.since_ns,
                row.onset_ns,
                row.settled,
            )
            for row in view.rows(select(entries).where(entries.c.robot == robot).order_by(entries.c.atom))
        ),
        tuple(
            StoredAssertion(row.name, row.sentence, row.source, row.time_ns, row.expires_ns)
            for row in view.rows(
                select(assertions).where(assertions.c.robot == robot).order_by(assertions.c.name)
            )
        ),
    )


def history(view: View, robot: str, paging: Paging = FIRST_PAGE) -> Page[StoredBatch]:
    """Return the accepted batches, newest first."""
    table = schema.observations
    return view.newest_first(table, _batch, paging, table.c.robot == checked(robot), key="revision")


def observe(
    tx: Transaction,
    robot: str,
    *,
    accepted: Sequence[Entry] = (),
    changed: Sequence[Entry] = (),
    forgotten: Sequence[Atom] = (),
    asserted: Sequence[StoredAssertion] = (),
    withdrawn: Sequence[str] = (),
    expected: int | None = None,
    by: str = "",
) -> int:
    """Keep one batch and return the robot's new revision, one higher than before.

    `accepted` goes into the history; `changed` and `forgotten` are what OBS ⊕ accepted changes in OBS
    (the store knows nothing of ⊕); `asserted` and `withdrawn` are named assertions; `by` is the reporter.

    Raises:
        NotFound: no such robot.
        StateConflict: `expected` is given and is not the revision before (code "stale-revision"): another
            instance was faster; load OBS again.
    """
    state = _at(tx, robot, expected)
    rows, revision = tx.waiting, state.revision + 1
    rows.history.append((robot, revision, tx.now_ns, batch_to_text(accepted, asserted, withdrawn, by)))
    _hold(tx, robot, changed)
    for gone in forgotten:
        rows.obs[robot, atom_to_text(gone)] = None
    rows.revised.add(robot)
    tx.now_is(robot, LockedRobot(revision, *state[1:]))
    if asserted or withdrawn:
        _assert(tx, robot, asserted, withdrawn)
    return revision


def renew(tx: Transaction, robot: str, renewed: Sequence[Entry], *, expected: int) -> bool:
    """Keep what a batch that says nothing new has renewed of OBS, in place: no revision, nothing in the
    history, and no key for its repetition, which is harmless by the batch's own time.

    Returns False, and keeps nothing, while a repair or a drill of the robot is open: then each report is
    evidence, which other instances and a restart look for in the history.

    Raises:
        NotFound, StateConflict: as `observe`.
    """
    _at(tx, robot, expected)
    if tx.worked_on(robot):
        return False
    _hold(tx, robot, renewed)
    return True


def _at(tx: Transaction, robot: str, expected: int | None) -> LockedRobot:
    """Return the locked row of a robot that is at the expected revision."""
    state = tx.existing(robot)
    if expected is not None and expected != state.revision:
        error = StateConflict(f"{robot!r} is at revision {state.revision}, not {expected}; load OBS again")
        error.code = "stale-revision"
        raise error
    return state


def _hold(tx: Transaction, robot: str, entries: Sequence[Entry]) -> None:
    obs = tx.waiting.obs
    for entry in entries:
        atom, positive = entry.literal
        times = (entry.time_ns, entry.expires_ns, entry.since_ns, entry.onset_ns, entry.settled)
        for time_ns in times:
            if time_ns is not None and time_ns not in INT64:
                checked_ns(time_ns)
        key = atom_to_text(atom)
        obs[robot, key] = (robot, key, positive, checked(entry.source), *times)


def _assert(
    tx: Transaction, robot: str, asserted: Sequence[StoredAssertion], withdrawn: Sequence[str]
) -> None:
    table = schema.assertions
    for name in withdrawn:
        gone = table.delete().where(table.c.robot == robot, table.c.name == checked(name))
        if not tx.change(gone):
            raise NotFound(f"{robot!r} has no assertion {name!r}")
    for assertion in asserted:
        tx.replace(
            table,
            {
                "robot": robot,
                "name": checked(assertion.name),
                "sentence": checked(assertion.sentence),
                "source": checked(assertion.source),
                "time_ns": checked_ns(assertion.time_ns),
                "expires_ns": None if assertion.expires_ns is None else checked_ns(assertion.expires_ns),
            },
        )


def _batch(row: AnyRow) -> StoredBatch:
    return StoredBatch(row.robot, row.revision, row.time_ns, *batch_from_text(row.data))
