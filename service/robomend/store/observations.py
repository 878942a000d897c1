"""Observations: OBS as it is now, the named assertions, and the history of what was accepted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sqlalchemy import select

from robomend.entry import Entry
from robomend.errors import NotFound, StateConflict
from robomend.store import folding, schema
from robomend.store.encoding import atom_to_text, batch_of, batch_to_text, checked, checked_ns, told
from robomend.store.records import (
    FIRST_PAGE,
    Page,
    Paging,
    StoredAssertion,
    StoredBatch,
    StoredObs,
)
from robomend.store.rows import BATCHES, OBSERVED, AnyRow, LockedRobot, Logged, View
from robomend.store.transaction import Transaction
from robomend_client.events import Kind
from robomend_client.literals import Atom


def revision(view: View, robot: str) -> int:
    """Return how many batches were accepted; 0 for an unknown robot."""
    if isinstance(view, Transaction):
        state = view.state(checked(robot))
        return 0 if state is None else state.revision
    return folding.revision(view, robot)


def obs(view: View, robot: str) -> StoredObs:
    """Return OBS now, expired entries included: freshness is judged by whoever reads it."""
    assertions = schema.assertions
    of_robot = select(assertions).where(assertions.c.robot == checked(robot)).order_by(assertions.c.name)
    made = tuple(
        StoredAssertion(row.name, row.sentence, row.source, row.time_ns, row.expires_ns)
        for row in view.rows(of_robot)
    )
    return replace(folding.obs(view, robot), assertions=made)


def history(view: View, robot: str, paging: Paging = FIRST_PAGE) -> Page[StoredBatch]:
    """Return the accepted batches, newest first."""
    return view.newest_of_log(robot, BATCHES, _batch, paging, schema.events.c.batch.is_not(None))


def observe(
    tx: Transaction,
    robot: str,
    *,
    accepted: Sequence[Entry] = (),
    changed: Sequence[Entry] = (),
    renewed: Sequence[Entry] = (),
    forgotten: Sequence[Atom] = (),
    asserted: Sequence[StoredAssertion] = (),
    withdrawn: Sequence[str] = (),
    expected: int | None = None,
    by: str = "",
    accepted_ns: int | None = None,
) -> int:
    """Keep one batch, with its event, and return the robot's new revision, one higher than before.

    `accepted` goes into the history. `changed`, `renewed` and `forgotten` are what OBS ⊕ accepted changes in
    OBS (the store knows nothing of ⊕); of `changed` the event tells, `renewed` only lives on. `asserted` and
    `withdrawn` are named assertions; `by` is the reporter; `accepted_ns` is when it came, if not just now.

    Raises:
        NotFound: no such robot.
        StateConflict: `expected` is given and is not the revision before (code "stale-revision"): another
            instance was faster; load OBS again.
    """
    state = _at(tx, robot, expected)
    waiting, revision, now_ns = tx.waiting, state.revision + 1, tx.now_ns
    if accepted_ns is None:
        accepted_ns = now_ns
    large = len(accepted) + len(changed) + len(renewed) > folding.LARGE
    if large:
        for entry in (*changed, *renewed):
            waiting.obs[robot, atom_to_text(entry.atom)] = folding.obs_row(robot, entry, revision)
    batch = batch_to_text(
        accepted,
        changed,
        renewed,
        forgotten,
        asserted,
        withdrawn,
        by=by,
        took_ns=now_ns - accepted_ns,
        in_rows=large,
    )
    event = told(revision, changed, forgotten, accepted_ns)
    tell = ((Kind.OBSERVATIONS, event),)
    waiting.log.append(Logged(OBSERVED, robot, revision, batch, None, None, tell))
    waiting.revised.add(robot)
    if folding.due(robot, revision):
        waiting.folding.add(robot)
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
    for entry in renewed:
        tx.waiting.obs[robot, atom_to_text(entry.atom)] = folding.obs_row(robot, entry, expected)
    return True


def _at(tx: Transaction, robot: str, expected: int | None) -> LockedRobot:
    """Return the locked row of a robot that is at the expected revision."""
    state = tx.existing(robot)
    if expected is not None and expected != state.revision:
        error = StateConflict(f"{robot!r} is at revision {state.revision}, not {expected}; load OBS again")
        error.code = "stale-revision"
        raise error
    return state


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
    return batch_of(row.batch, row.robot, row.revision, row.time_ns)
