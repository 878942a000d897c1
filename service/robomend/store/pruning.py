"""Retention: remove what is old, a little at a time, so that nobody waits long for a pruning; and growth.

    look for what is old (in a reader's thread) ──► remove some by their keys (the writer) ──► rest ──┐
              ▲                                            ▲   next time as many as fit STEP_S        │
              └────── none left of those found ────────────┴──────────────────────────────────────────┘

"Old" is by the clock, the only place where it decides; what goes is always the beginning of a log, as a hole
in the middle would be a lie. If the clock once jumped ahead, the log is kept longer; if back, nothing younger
goes. What is current stays: OBS, the latest diagnosis of a robot, open drills, open repairs and
their journal.

The log of events is several: batches, diagnoses, batches with their diagnosis, and others, each kept for its
time, and at least as long as events are. A counter for each has the id up to which it was looked through.
"""

from __future__ import annotations

import asyncio
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import takewhile
from typing import Any

from sqlalchemy import ColumnElement, Table, func, select

from robomend.store import events, schema
from robomend.store.records import Paging, Pruned, Retention
from robomend.store.rows import BATCHES, CHANGE, DAY_NS, DIAGNOSED, DIAGNOSES, OBSERVED, View, as_it_is
from robomend.store.store import Store
from robomend.store.transaction import Transaction

STEP_S = 0.005
"""How long one step holds the writer, about; its COMMIT comes to that."""

REST_S = 0.02
"""Between two steps: the writer is others'."""

FIRST = 50
"""Records in the first step, before it is known how long they take."""

LOOK = 2000
"""Records looked for at once."""

STRETCH = 20_000
"""Ids of the log that are looked through at once."""

AT_ONCE = 8
"""Robots of which OBS is brought up to the log in one transaction."""

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
    for cut, what, kinds, days in _parts_of_log(retention):
        if days is not None:
            before = now - int(days * DAY_NS)
            while stretch := await store.read(_old_of_log, cut, kinds, before):
                await _bring_up(store, stretch.unfolded)
                gone = await pace.remove(store, stretch.old, partial(_remove_of_log, cut))
                await store.write(partial(_count_to, cut, stretch.last))
                pruned = replace(pruned, **{what: getattr(pruned, what) + gone})
    days = _longest(retention.observations_days, retention.diagnoses_days, retention.events_days)
    if days is not None:
        unused_since = now // DAY_NS - int(days) - 2
        if await store.read(_unused_results, unused_since):
            await _still_used(store, now // DAY_NS)
        while keys := await store.read(_unused_results, unused_since):
            gone = await pace.remove(store, keys, partial(_remove_unused, unused_since))
            pruned = replace(pruned, results=pruned.results + gone)
    work: tuple[tuple[str, Find, Remove, float | None], ...] = (
        ("repairs", _old_repairs, _remove_repairs, retention.repairs_days),
        ("tried", *_log(schema.tried, "number"), retention.tried_days),
        ("tried", *_log(schema.attempts, "number"), retention.tried_days),
        ("audit", *_log(schema.audit, "id"), retention.audit_days),
        ("idempotency", _expired_keys, partial(_remove, schema.idempotency, "number"), 0.0),
        ("agent_actions", *_rows(schema.agent_actions, "queued_ns"), retention.repairs_days),
        ("notifications", *_notifications(), retention.events_days),
        ("drills", *_rows(schema.drills, "updated_ns", ~schema.drills.c.open), retention.repairs_days),
        ("moments", *_rows(schema.moments, "created_ns"), retention.moments_days),
        ("moments", _left_pieces, partial(_remove, schema.moment_pieces, "number"), 0.0),
    )
    for what, find, remove, days in work:
        if days is None:
            continue
        before = now - int(days * DAY_NS)
        while keys := await store.read(find, before):
            count = await pace.remove(store, keys, remove)
            pruned = replace(pruned, **{what: getattr(pruned, what) + count})
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


_LOG = schema.events
OTHERS = tuple(kind for kind in events.KINDS if kind not in {*BATCHES, *DIAGNOSES})


def _parts_of_log(retention: Retention) -> tuple[tuple[str, str, Sequence[str], float | None], ...]:
    """Return the parts of the log, each with its counter, what is counted of it, and how long it is kept."""
    batches, diagnoses, others = retention.observations_days, retention.diagnoses_days, retention.events_days
    return (
        (events.CUT, "events", OTHERS, others),
        ("observations-cut", "observations", (OBSERVED,), _longest(batches, others)),
        ("diagnoses-cut", "diagnoses", (DIAGNOSED,), _longest(diagnoses, others)),
        ("changes-cut", "observations", (CHANGE,), _longest(batches, diagnoses, others)),
    )


def _longest(*days: float | None) -> float | None:
    """Return the longest of several times; None is for ever."""
    known = [one for one in days if one is not None]
    return max(known) if len(known) == len(days) else None


@dataclass(frozen=True, slots=True)
class _Stretch:
    """A stretch of the log that is old."""

    last: int  # the id of its last row
    old: Keys  # of the rows that go
    unfolded: Sequence[str]  # robots of which OBS rests on some of these


def _old_of_log(view: View, cut: str, kinds: Sequence[str], before: int) -> _Stretch | None:
    """Return the next stretch of the log, as far as it is older, and its rows of these kinds that may go."""
    behind = _LOG.c.id > events.counter(view, cut)
    start = view.first(select(_LOG.c.id).where(behind).order_by(_LOG.c.id))
    if start is None:
        return None
    within = behind & (_LOG.c.id < start.id + STRETCH)
    young = view.first(select(_LOG.c.id).where(within, _LOG.c.time_ns >= before).order_by(_LOG.c.id))
    if young is not None:
        within &= _LOG.c.id < young.id
    last = view.rows(select(func.max(_LOG.c.id)).where(within))[0][0]
    if last is None:
        return None
    states = schema.robot_state
    query = (
        select(_LOG.c.id, _LOG.c.kind, _LOG.c.robot, _LOG.c.revision, states.c.folded)
        .outerjoin_from(_LOG, states, states.c.robot == _LOG.c.robot)
        .where(within, _LOG.c.kind.in_(kinds))
        .order_by(_LOG.c.id)
        .limit(LOOK)
    )
    rows = view.rows(query)
    last = last if len(rows) < LOOK else rows[-1].id
    old = {row.id for row in rows}
    for robot in {row.robot for row in rows if row.kind in DIAGNOSES}:
        old |= _left(view, robot, kinds, last)
        old -= _current(view, robot)
    unfolded = {row.robot for row in rows if row.kind in BATCHES and (row.folded or 0) < (row.revision or 0)}
    return _Stretch(last, sorted(old), sorted(unfolded))


def _left(view: View, robot: str, kinds: Sequence[str], until: int) -> set[int]:
    """Return the robot's rows of these kinds up to an id: those that were its latest diagnosis, too."""
    of_robot = (_LOG.c.robot == robot, _LOG.c.kind.in_(kinds), _LOG.c.id <= until)
    return {row.id for row in view.rows(select(_LOG.c.id).where(*of_robot).order_by(_LOG.c.id).limit(LOOK))}


def _current(view: View, robot: str) -> set[int]:
    """Return the row of the robot's latest diagnosis, if the robot is there."""
    if view.first(select(schema.robots.c.id).where(schema.robots.c.id == robot)) is None:
        return set()
    return {row.id for row in view.newest_of_log(robot, DIAGNOSES, as_it_is, Paging(limit=1)).items}


async def _bring_up(store: Store, robots: Sequence[str]) -> None:
    """Bring OBS of robots up to the log, a few at a time."""
    for start in range(0, len(robots), AT_ONCE):
        some = robots[start : start + AT_ONCE]

        def bring_up(tx: Transaction, some: Sequence[str] = some) -> None:
            for robot in some:
                tx.bring_up(robot)

        await store.write(bring_up, robots=some)
        await asyncio.sleep(REST_S)


def _remove_of_log(cut: str, tx: Transaction, ids: Keys) -> None:
    counters = schema.counters
    newest = select(func.max(_LOG.c.id)).scalar_subquery()  # an id is not given twice
    tx.change(
        counters.update().where(counters.c.name == "event", counters.c.value < newest).values(value=newest)
    )
    tx.change(_LOG.delete().where(_LOG.c.id.in_(ids)))
    _count_to(cut, ids[-1], tx)


def _count_to(cut: str, last: int, tx: Transaction) -> None:
    """Note how far the log was looked through."""
    if events.counter(tx, cut) < last:
        tx.replace(schema.counters, {"name": cut, "value": last})


async def _still_used(store: Store, today: int) -> None:
    """Mark the results of rows that stay though they are old."""

    def look(view: View) -> list[int]:
        used: set[int] = set()
        for cut, _, kinds, _ in _parts_of_log(Retention()):
            behind = select(_LOG.c.common).where(
                _LOG.c.id <= events.counter(view, cut), _LOG.c.kind.in_(kinds), _LOG.c.common.is_not(None)
            )
            used.update(row.common for row in view.rows(behind))
        return sorted(used)

    table = schema.results
    numbers = await store.read(look)
    for start in range(0, len(numbers), LOOK):
        some = table.c.number.in_(numbers[start : start + LOOK])
        used = table.update().where(some, table.c.used_day < today).values(used_day=today)
        await store.write(partial(Transaction.change, statement=used))


def _unused_results(view: View, since: int) -> Keys:
    table = schema.results
    old = select(table.c.number).where(table.c.used_day < since).order_by(table.c.used_day).limit(LOOK)
    return [row.number for row in view.rows(old)]


def _remove_unused(since: int, tx: Transaction, keys: Keys) -> None:
    """Remove results, but not what was used again since it was looked for."""
    table = schema.results
    tx.change(table.delete().where(table.c.number.in_(keys), table.c.used_day < since))


def _old_repairs(view: View, before: int) -> Keys:
    table = schema.repairs
    old = select(table.c.id).where(~table.c.open, table.c.updated_ns < before)
    return [row.id for row in view.rows(old.order_by(table.c.number).limit(LOOK))]


def _remove_repairs(tx: Transaction, ids: Keys) -> None:
    for part in (schema.repair_steps, schema.repair_requests, schema.journal):
        _remove(part, "repair", tx, ids)
    _remove(schema.repairs, "id", tx, ids)


def _left_pieces(view: View, before: int) -> Keys:
    """Return pieces of recordings whose moment is gone."""
    pieces, moments = schema.moment_pieces, schema.moments
    there = select(moments.c.number).where(moments.c.number == pieces.c.moment).exists()
    left = select(pieces.c.number).where(~there).order_by(pieces.c.number).limit(LOOK)
    return [row.number for row in view.rows(left)]


def _expired_keys(view: View, before: int) -> Keys:
    table = schema.idempotency
    oldest = select(table.c.number, table.c.expires_ns).order_by(table.c.number).limit(LOOK)
    return [row.number for row in takewhile(lambda row: row.expires_ns < before, view.rows(oldest))]


def _remove(table: Table, key: str, tx: Transaction, values: Keys) -> None:
    tx.change(table.delete().where(table.c[key].in_(values)))


# --- how fast the database grows, measured on what was written last

NEWEST = 20_000
"""Rows of the log by which its growth is measured."""

ROW = 70
"""Bytes that a row takes beside its texts, with its place in the index, about."""

LEAST_DAYS = 1 / 144
"""Ten minutes: a shorter history says nothing of a day."""


@dataclass(frozen=True, slots=True)
class Growth:
    """Bytes a day, by what was written in the last day of the history."""

    days: float  # how much of a day the figures are of
    robots: Mapping[str, float]  # of each that something was written about
    logs: Mapping[str, float]  # of each kind of row of the log, and of the results that diagnoses share

    @property
    def bytes_a_day(self) -> float:
        """All of it."""
        return sum(self.logs.values())

    def kept(self, retention: Retention) -> float | None:
        """Return how large the logs become until what is written is what goes; None: without an end."""
        batches = _longer(retention.observations_days, retention.events_days)
        diagnoses = _longer(retention.diagnoses_days, retention.events_days)
        changes = _longer(batches, diagnoses)
        days = {
            OBSERVED: batches,
            DIAGNOSED: diagnoses,
            CHANGE: changes,
            "results": changes,
        }
        total = 0.0
        for log, bytes_a_day in self.logs.items():
            kept = days.get(log, retention.events_days)
            if kept is None:
                return None
            total += bytes_a_day * kept
        return total


def measure(view: View, now_ns: int) -> Growth:
    """Return what the last day of the history grew by, as far as the newest rows of each log tell.

    Robots of one model share results, so what a result takes is not any robot's; all that were met count, as
    if none had been there before.
    """
    log = schema.events.c
    sizes = [func.coalesce(func.length(column), 0) for column in (log.batch, log.data)]
    columns = (log.robot, log.kind, log.time_ns, log.common, (sizes[0] + sizes[1]).label("size"))
    rows = view.rows(select(*columns).order_by(log.id.desc()).limit(NEWEST))
    if not rows:
        return Growth(0.0, {}, {})
    end_ns = now_ns if now_ns - rows[0].time_ns < DAY_NS else rows[0].time_ns
    young = [row for row in rows if row.time_ns > end_ns - DAY_NS]
    days = 1.0 if len(young) < len(rows) else (end_ns - rows[-1].time_ns) / DAY_NS
    days = max(LEAST_DAYS, min(1.0, days))
    robots: defaultdict[str, float] = defaultdict(float)
    logs: defaultdict[str, float] = defaultdict(float)
    for row in young:
        logs[row.kind] += (row.size + ROW) / days
        if row.robot is not None:
            robots[row.robot] += (row.size + ROW) / days
    logs["results"] = _bytes_of(view, {row.common for row in young if row.common is not None}) / days
    return Growth(days, dict(robots), dict(logs))


def _bytes_of(view: View, results: set[int]) -> float:
    table, numbers, total = schema.results, sorted(results), 0.0
    for start in range(0, len(numbers), 500):
        size = select(func.length(table.c.data).label("size"))
        rows = view.rows(size.where(table.c.number.in_(numbers[start : start + 500])))
        total += sum(row.size + ROW for row in rows)
    return total


def _longer(one: float | None, other: float | None) -> float | None:
    return None if one is None or other is None else max(one, other)
