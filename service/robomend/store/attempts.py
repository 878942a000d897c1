"""What was tried: the memory of repairs, the attempts that are counted, and the components in quarantine.

Writes of the repair loop carry a fence, see repairs.py.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from sqlalchemy import func, select

from robomend.errors import NotFound
from robomend.store import schema
from robomend.store.encoding import checked, checked_or_none, from_json, to_json
from robomend.store.records import Fence, Quarantine, StoredAttempt
from robomend.store.rows import AnyRow, View
from robomend.store.transaction import Transaction

_TRIED, _ATTEMPTS, _QUARANTINE = schema.tried, schema.attempts, schema.quarantine
_ROBOTS = schema.robots


MOST = 100
MOST_LOOKED_AT = 2_000
"""Attempts of one robot: that are returned, and that are looked at for these."""


def tried(view: View, robot: str, *, drill: str | None = None) -> tuple[StoredAttempt, ...]:
    """Return what the latest attempts came to, newest first; of drills only those of `drill`.

    An hour of drills does not make us forget what was tried of real faults before.
    """
    query = select(_TRIED).where(_TRIED.c.robot == checked(robot)).order_by(_TRIED.c.number.desc())
    found: list[StoredAttempt] = []
    for most in (MOST, MOST_LOOKED_AT):
        read = [_attempt(row) for row in view.rows(query.limit(most))]
        found = [one for one in read if one.data.get("drill") in {None, drill}][:MOST]
        if len(found) == MOST or len(read) < most:
            break
    return tuple(found)


FLEET, EACH = 500, 5
"""Attempts of other robots that are looked at, and of those that blamed the same on one robot: a device that
is broken must not count again and again for all others.
"""


def of_fleet(view: View, robot: str) -> tuple[StoredAttempt, ...]:
    """Return what the latest attempts on other robots of the model came to, newest first, drills aside."""
    model = select(_ROBOTS.c.model).where(_ROBOTS.c.id == checked(robot)).scalar_subquery()
    others = select(_ROBOTS.c.id).where(_ROBOTS.c.model == model, _ROBOTS.c.id != checked(robot))
    newest = select(_TRIED).order_by(_TRIED.c.number.desc()).limit(MOST_LOOKED_AT).subquery()
    query = select(newest).where(newest.c.robot.in_(others)).order_by(newest.c.number.desc()).limit(FLEET)
    seen: Counter[tuple[str, tuple[str, ...]]] = Counter()
    found: list[StoredAttempt] = []
    for one in map(_attempt, view.rows(query)):
        seen[one.robot, one.bad] += 1
        if one.data.get("drill") is None and seen[one.robot, one.bad] <= EACH:
            found.append(one)
    return tuple(found)


def remember(tx: Transaction, attempt: StoredAttempt, *, fence: Fence) -> None:
    """Keep what an attempt came to."""
    tx.check_fence(attempt.robot, fence)
    tx.insert(
        _TRIED,
        {
            "robot": attempt.robot,
            "bad": to_json(list(attempt.bad)),
            "actions": to_json(list(attempt.actions)),
            "helped": attempt.helped,
            "effect_seen": attempt.effect_seen,
            "repair": checked_or_none(attempt.repair),
            "time_ns": attempt.time_ns,
            "data": to_json(attempt.data),
        },
    )


def forget(tx: Transaction, robot: str, component: str) -> int:
    """Forget the attempts that blamed a component, as after it was exchanged; return how many."""
    rows = tx.rows(select(_TRIED.c.number, _TRIED.c.bad).where(_TRIED.c.robot == checked(robot)))
    blamed = [row.number for row in rows if component in from_json(row.bad)]
    return tx.change(_TRIED.delete().where(_TRIED.c.number.in_(blamed))) if blamed else 0


def count(tx: Transaction, robot: str, component: str, repair: str, *, fence: Fence) -> None:
    """Count an attempt to repair a component, for the limit per hour."""
    tx.check_fence(robot, fence)
    row = {"robot": robot, "component": checked(component), "repair": checked(repair)}
    tx.insert(_ATTEMPTS, row | {"time_ns": tx.now_ns})


def counted(view: View, robot: str, since_ns: int) -> Mapping[str, int]:
    """Return component -> attempts counted since that time."""
    query = (
        select(_ATTEMPTS.c.component, func.count().label("attempts"))
        .where(_ATTEMPTS.c.robot == checked(robot), _ATTEMPTS.c.time_ns >= since_ns)
        .group_by(_ATTEMPTS.c.component)
    )
    return {row.component: row.attempts for row in view.rows(query)}


def quarantine(view: View, robot: str) -> tuple[Quarantine, ...]:
    """Return the components in quarantine, by name, including those whose time is over."""
    query = select(_QUARANTINE).where(_QUARANTINE.c.robot == checked(robot))
    return tuple(_quarantine(row) for row in view.rows(query.order_by(_QUARANTINE.c.component)))


def put_quarantine(tx: Transaction, entry: Quarantine, *, fence: Fence) -> None:
    """Set a component aside, or for longer."""
    tx.check_fence(entry.robot, fence)
    tx.replace(
        _QUARANTINE,
        {
            "robot": entry.robot,
            "component": checked(entry.component),
            "reason": checked(entry.reason),
            "failures": entry.failures,
            "since_ns": entry.since_ns,
            "until_ns": entry.until_ns,
        },
    )


def release_quarantine(tx: Transaction, robot: str, component: str) -> Quarantine:
    """Let the component be tried again; NotFound if it is not in quarantine. A person's word: no fence."""
    table = _QUARANTINE
    of_component = (table.c.robot == checked(robot)) & (table.c.component == checked(component))
    row = tx.first(select(table).where(of_component).with_for_update())
    if row is None:
        raise NotFound(f"component {component!r} of {robot!r} is not in quarantine")
    tx.change(table.delete().where(of_component))
    return _quarantine(row)


def _attempt(row: AnyRow) -> StoredAttempt:
    return StoredAttempt(
        robot=row.robot,
        bad=tuple(from_json(row.bad)),
        actions=tuple(from_json(row.actions)),
        helped=row.helped,
        effect_seen=row.effect_seen,
        repair=row.repair,
        time_ns=row.time_ns,
        data=from_json(row.data),
    )


def _quarantine(row: AnyRow) -> Quarantine:
    return Quarantine(row.robot, row.component, row.reason, row.failures, row.since_ns, row.until_ns)
