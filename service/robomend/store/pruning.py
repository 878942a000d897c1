"""Retention: remove what is old, a slice at a time, so that nobody waits long for a pruning.

"Old" is by the clock, the only place where it decides; what goes is always the beginning of a log, as a hole
in the middle would be a lie. If the clock once jumped ahead, the log is kept longer; if back, nothing younger
goes. What is current stays: OBS, the latest diagnosis of a robot, open drills, open repairs and
their journal.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from sqlalchemy import Table, exists, select

from robomend.store import schema
from robomend.store.records import Pruned, Retention
from robomend.store.store import Store
from robomend.store.transaction import Transaction

_DAY_NS = 86_400_000_000_000

Slice = Callable[[int, int, Transaction], int]
"""Given a time and a number, remove up to so many older records, and return how many."""


async def prune(store: Store, retention: Retention, *, slice: int = 1000) -> Pruned:
    """Remove everything that the retention does not keep, in slices of so many records."""
    now = time.time_ns()
    work: tuple[tuple[str, Slice, float | None], ...] = (
        ("observations", _prefix(schema.observations, "number"), retention.observations_days),
        ("diagnoses", _old_diagnoses, retention.diagnoses_days),
        ("events", _prefix(schema.events, "id"), retention.events_days),
        ("repairs", _old_repairs, retention.repairs_days),
        ("tried", _prefix(schema.tried, "number"), retention.tried_days),
        ("tried", _prefix(schema.attempts, "number"), retention.tried_days),
        ("audit", _prefix(schema.audit, "id"), retention.audit_days),
        ("idempotency", _expired_keys, 0.0),
        ("agent_actions", _old_agent_actions, retention.repairs_days),
        ("notifications", _old_notifications, retention.events_days),
        ("drills", _old_drills, retention.repairs_days),
    )
    pruned = Pruned()
    for what, remove, days in work:
        if days is None:
            continue
        before = now - int(days * _DAY_NS)
        while True:
            count = await store.write(partial(remove, before, slice))
            pruned = replace(pruned, **{what: getattr(pruned, what) + count})
            if count < slice:
                break
    return pruned


def _prefix(table: Table, key: str) -> Slice:
    """Return what removes the beginning of a log, up to the first entry that is young enough."""
    column = table.c[key]

    def remove(before: int, slice: int, tx: Transaction) -> int:
        first = tx.rows(select(column, table.c.time_ns).order_by(column).limit(slice))
        old = 0
        while old < len(first) and first[old].time_ns < before:
            old += 1
        if old:
            tx.change(table.delete().where(column <= first[old - 1][0]))
        return old

    return remove


def _old_diagnoses(before: int, slice: int, tx: Transaction) -> int:
    table = schema.diagnoses
    newer = table.alias("newer")
    replaced = exists().where(newer.c.robot == table.c.robot, newer.c.number > table.c.number)
    old = (
        select(table.c.number)
        .where(table.c.time_ns < before, replaced)
        .order_by(table.c.time_ns)
        .limit(slice)
    )
    return _remove(tx, table, "number", [row.number for row in tx.rows(old)])


def _old_repairs(before: int, slice: int, tx: Transaction) -> int:
    table = schema.repairs
    old = (
        select(table.c.id)
        .where(~table.c.open, table.c.updated_ns < before)
        .order_by(table.c.number)
        .limit(slice)
    )
    ids = [row.id for row in tx.rows(old)]
    for part in (schema.repair_steps, schema.repair_requests, schema.journal):
        _remove(tx, part, "repair", ids)
    return _remove(tx, table, "id", ids)


def _old_agent_actions(before: int, slice: int, tx: Transaction) -> int:
    table = schema.agent_actions
    old = select(table.c.number).where(table.c.queued_ns < before).order_by(table.c.number).limit(slice)
    return _remove(tx, table, "number", [row.number for row in tx.rows(old)])


def _old_notifications(before: int, slice: int, tx: Transaction) -> int:
    table = schema.notifications
    old = select(table.c.number).where(table.c.created_ns < before, table.c.due_ns.is_(None))
    rows = tx.rows(old.order_by(table.c.number).limit(slice))
    return _remove(tx, table, "number", [row.number for row in rows])


def _old_drills(before: int, slice: int, tx: Transaction) -> int:
    table = schema.drills
    ended = select(table.c.number).where(~table.c.open, table.c.updated_ns < before)
    rows = tx.rows(ended.order_by(table.c.number).limit(slice))
    return _remove(tx, table, "number", [row.number for row in rows])


def _expired_keys(before: int, slice: int, tx: Transaction) -> int:
    table = schema.idempotency
    old = tx.rows(select(table.c.scope, table.c.key).where(table.c.expires_ns < before).limit(slice))
    for row in old:
        tx.change(table.delete().where(table.c.scope == row.scope, table.c.key == row.key))
    return len(old)


def _remove(tx: Transaction, table: Table, key: str, values: list[object]) -> int:
    if values:
        tx.change(table.delete().where(table.c[key].in_(values)))
    return len(values)
