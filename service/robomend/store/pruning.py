"""Retention: remove what is old, a little at a time, so that nobody waits long for a pruning.

    look for what is old (in a reader's thread) ──► remove some by their keys (the writer) ──► rest ──┐
              ▲                                            ▲   next time as many as fit STEP_S        │
              └────── none left of those found ────────────┴──────────────────────────────────────────┘

"Old" is by the clock, the only place where it decides; what goes is always the beginning of a log, as a hole
in the middle would be a lie. If the clock once jumped ahead, the log is kept longer; if back, nothing younger
goes. What is current stays: OBS, the latest diagnosis of a robot, open drills, open repairs and
their journal.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from sqlalchemy import ColumnElement, Table, exists, select

from robomend.store import results, schema
from robomend.store.records import Pruned, Retention
from robomend.store.store import Store
from robomend.store.transaction import Transaction
from robomend.store.view import View

DAY_NS = results.DAY_NS

STEP_S = 0.005
"""How long one step holds the writer, about; its COMMIT comes to that."""

REST_S = 0.02
"""Between two steps: the writer is others'."""

FIRST = 50
"""Records in the first step, before it is known how long they take."""

LOOK = 2000
"""Records looked for at once."""

Keys = Sequence[Any]
Find = Callable[[View, int], Keys]
"""Given a time, return keys of some records that are older, at most LOOK."""
Remove = Callable[[Transaction, Keys], None]


async def prune(store: Store, retention: Retention, *, slice: int | None = None) -> Pruned:
    """Remove everything that the retention does not keep.

    Args:
        slice: so many records in each step; by default what is removed in about `STEP_S`.
    """
    now = time.time_ns()
    pace = Pace(slice)
    pruned = Pruned()
    work: tuple[tuple[str, Find, Remove, float | None], ...] = (
        ("observations", *_log(schema.observations, "number"), retention.observations_days),
        ("events", *_log(schema.events, "id"), retention.events_days),
        ("repairs", _old_repairs, _remove_repairs, retention.repairs_days),
        ("tried", *_log(schema.tried, "number"), retention.tried_days),
        ("tried", *_log(schema.attempts, "number"), retention.tried_days),
        ("audit", *_log(schema.audit, "id"), retention.audit_days),
        ("idempotency", _expired_keys, _remove_expired_keys, 0.0),
        ("agent_actions", *_rows(schema.agent_actions, "queued_ns"), retention.repairs_days),
        ("notifications", *_notifications(), retention.events_days),
        ("drills", *_rows(schema.drills, "updated_ns", ~schema.drills.c.open), retention.repairs_days),
    )
    for what, find, remove, days in work:
        if days is None:
            continue
        before = now - int(days * DAY_NS)
        while keys := await store.read(find, before):
            count = await pace.remove(store, keys, remove)
            pruned = replace(pruned, **{what: getattr(pruned, what) + count})
    if retention.diagnoses_days is not None:
        before = now - int(retention.diagnoses_days * DAY_NS)
        async for old, current in _old_diagnoses(store, before):
            await pace.remove(store, current, partial(_still_used, now // DAY_NS))
            count = await pace.remove(store, old, partial(_remove, schema.diagnoses, "number"))
            pruned = replace(pruned, diagnoses=pruned.diagnoses + count)
        if retention.events_days is not None:
            unused_since = now // DAY_NS - int(max(retention.diagnoses_days, retention.events_days)) - 2
            while keys := await store.read(_unused_results, unused_since):
                count = await pace.remove(store, keys, partial(_remove_unused, unused_since))
                pruned = replace(pruned, results=pruned.results + count)
    return pruned


class Pace:
    """How much is removed in one step: what takes about `STEP_S`, and then a rest."""

    def __init__(self, fixed: int | None = None) -> None:
        self._fixed = fixed
        self._size = fixed or FIRST
        self.longest_s = 0.0

    async def remove(self, store: Store, keys: Keys, remove: Remove) -> int:
        """Remove the records of these keys, step by step, and return how many they are."""
        done = 0
        while done < len(keys):
            some = keys[done : done + self._size]
            took_s = await store.write(partial(self._step, some, remove))
            done += len(some)
            self.longest_s = max(self.longest_s, took_s)
            if self._fixed is None:
                self._size = max(1, min(LOOK, int(len(some) * min(2.0, STEP_S / max(took_s, 1e-6)))))
            await asyncio.sleep(max(REST_S, 2 * took_s))
        return done

    def _step(self, keys: Keys, remove: Remove, tx: Transaction) -> float:
        began = time.perf_counter()
        remove(tx, keys)
        return time.perf_counter() - began


def _log(table: Table, key: str) -> tuple[Find, Remove]:
    """Return what removes the beginning of a log, up to the first entry that is young enough."""
    column = table.c[key]

    def find(view: View, before: int) -> Keys:
        keys = []
        for row in view.rows(select(column, table.c.time_ns).order_by(column).limit(LOOK)):
            if row.time_ns >= before:
                break
            keys.append(row[0])
        return keys

    def remove(tx: Transaction, keys: Keys) -> None:
        tx.change(table.delete().where(column <= keys[-1]))

    return find, remove


def _rows(table: Table, time_column: str, *where: ColumnElement[bool]) -> tuple[Find, Remove]:
    """Return what removes numbered rows of which the time is past, wherever they are."""
    number = table.c.number

    def find(view: View, before: int) -> Keys:
        old = select(number).where(table.c[time_column] < before, *where)
        return [row.number for row in view.rows(old.order_by(number).limit(LOOK))]

    return find, partial(_remove, table, "number")


def _notifications() -> tuple[Find, Remove]:
    table = schema.notifications
    return _rows(table, "created_ns", table.c.due_ns.is_(None))


async def _old_diagnoses(store: Store, before: int) -> AsyncIterator[tuple[Keys, Keys]]:
    """Yield old diagnoses, some at a time: numbers of those that go, and results of those that stay.

    What stays is the latest of each robot that is there.
    """

    def look(view: View, after: int) -> tuple[list[int], list[int], int]:
        table = schema.diagnoses
        newer = table.alias("newer")
        current = exists().where(schema.robots.c.id == table.c.robot) & ~exists().where(
            newer.c.robot == table.c.robot, newer.c.number > table.c.number
        )
        query = select(table.c.number, table.c.time_ns, table.c.common, current.label("current"))
        old: list[int] = []
        used: list[int] = []
        last = 0
        for row in view.rows(query.where(table.c.number > after).order_by(table.c.number).limit(LOOK)):
            if row.time_ns >= before:
                return old, used, 0
            last = row.number
            if not row.current:
                old.append(row.number)
            elif row.common is not None:
                used.append(row.common)
        return old, used, last

    after = -1
    while after != 0:
        old, used, after = await store.read(look, after)
        yield old, used


def _still_used(today: int, tx: Transaction, keys: Keys) -> None:
    table = schema.results
    used = table.update().where(table.c.number.in_(keys), table.c.used_day < today)
    tx.change(used.values(used_day=today))


def _unused_results(view: View, since: int) -> Keys:
    table = schema.results
    old = select(table.c.number).where(table.c.used_day < since).order_by(table.c.used_day).limit(LOOK)
    return [row.number for row in view.rows(old)]


def _remove_unused(since: int, tx: Transaction, keys: Keys) -> None:
    """Remove results, but not what was used again since it was looked for."""
    table = schema.results
    tx.change(table.delete().where(table.c.number.in_(keys), table.c.used_day < since))
    counter = schema.counters
    once_more = counter.update().where(counter.c.name == results.REMOVALS).values(value=counter.c.value + 1)
    if not tx.change(once_more):
        tx.change(counter.insert().values(name=results.REMOVALS, value=1))


def _old_repairs(view: View, before: int) -> Keys:
    table = schema.repairs
    old = select(table.c.id).where(~table.c.open, table.c.updated_ns < before)
    return [row.id for row in view.rows(old.order_by(table.c.number).limit(LOOK))]


def _remove_repairs(tx: Transaction, ids: Keys) -> None:
    for part in (schema.repair_steps, schema.repair_requests, schema.journal):
        _remove(part, "repair", tx, ids)
    _remove(schema.repairs, "id", tx, ids)


def _expired_keys(view: View, before: int) -> Keys:
    table = schema.idempotency
    old = select(table.c.scope, table.c.key, table.c.expires_ns).where(table.c.expires_ns < before)
    return [tuple(row) for row in view.rows(old.order_by(table.c.expires_ns).limit(LOOK))]


def _remove_expired_keys(tx: Transaction, keys: Keys) -> None:
    table = schema.idempotency
    for scope, key, expires_ns in keys:  # a key that was used again since has another end
        of_key = (table.c.scope == scope, table.c.key == key, table.c.expires_ns == expires_ns)
        tx.change(table.delete().where(*of_key))


def _remove(table: Table, key: str, tx: Transaction, values: Keys) -> None:
    tx.change(table.delete().where(table.c[key].in_(values)))
