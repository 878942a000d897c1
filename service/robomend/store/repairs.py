"""Repairs: how far each one and its steps have come, and what is asked of them.

Changes of a robot's configuration are kept like repairs, by ids of their own kind; where they are not asked
for, they are left out.

Everything the repair loop writes carries its fence (see ownership.py); an older one than the latest raises
Fenced: another instance has taken over; let go at once. The robot's row is locked while the fence is
compared, so that a take-over comes wholly before or wholly after the write.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sqlalchemy import ColumnElement, func, select

from robomend.errors import StateConflict
from robomend.store import schema
from robomend.store.encoding import checked, from_json, new_id, to_json
from robomend.store.records import (
    FIRST_PAGE,
    Fence,
    Json,
    Page,
    Paging,
    RepairRequest,
    StepRecord,
    StoredRepair,
)
from robomend.store.rows import AnyRow, View
from robomend.store.transaction import Transaction

_REPAIRS, _REQUESTS, _STEPS = schema.repairs, schema.repair_requests, schema.repair_steps

CHANGE = "c-"
"""How the id of a change of configuration begins; that of a repair begins with `r-`."""


def is_change(id_: str) -> bool:
    """Return whether this is the id of a change of configuration."""
    return id_.startswith(CHANGE)


def _changes(wanted: bool) -> ColumnElement[bool]:
    begin = func.substr(_REPAIRS.c.id, 1, len(CHANGE))
    return begin == CHANGE if wanted else begin != CHANGE


AT_ONCE = 500
"""Robots in one query; databases take some thousand parameters."""


def get(view: View, repair: str) -> StoredRepair:
    """Return a repair."""
    return _repair(view.one(select(_REPAIRS).where(_REPAIRS.c.id == checked(repair)), f"repair {repair!r}"))


def page(
    view: View,
    robot: str | None = None,
    paging: Paging = FIRST_PAGE,
    *,
    open_only: bool = False,
    state: str | None = None,
    changes: bool = False,
) -> Page[StoredRepair]:
    """Return repairs, or changes of configurations, newest first. The cursor may be an id: those older."""
    where = [_changes(changes)] if robot is None else [_changes(changes), _REPAIRS.c.robot == checked(robot)]
    if open_only:
        where.append(_REPAIRS.c.open)
    if state is not None:
        where.append(_REPAIRS.c.state == checked(state))
    if paging.cursor is not None and not paging.cursor.isdecimal():
        paging = replace(paging, cursor=str(get(view, paging.cursor).number))
    return view.newest_first(_REPAIRS, _repair, paging, *where)


def newest(view: View, robots: Sequence[str]) -> dict[str, StoredRepair]:
    """Return the newest repair of each of these robots that has one: a query for hundreds of them at once."""
    found = {}
    for first in range(0, len(robots), AT_ONCE):
        some = [checked(robot) for robot in robots[first : first + AT_ONCE]]
        last = (
            select(func.max(_REPAIRS.c.number))
            .where(_REPAIRS.c.robot.in_(some), _changes(False))
            .group_by(_REPAIRS.c.robot)
        )
        for row in view.rows(select(_REPAIRS).where(_REPAIRS.c.number.in_(last))):
            found[row.robot] = _repair(row)
    return found


def open_robots(view: View) -> tuple[str, ...]:
    """Return the robots that have an open repair."""
    query = select(_REPAIRS.c.robot).where(_REPAIRS.c.open, _changes(False))
    return tuple(row.robot for row in view.rows(query))


def requests(view: View, robot: str) -> tuple[RepairRequest, ...]:
    """Return what is asked of the robot's repairs and not done yet, oldest first."""
    query = select(_REQUESTS).where(_REQUESTS.c.robot == checked(robot), ~_REQUESTS.c.done)
    return tuple(_request(row) for row in view.rows(query.order_by(_REQUESTS.c.number)))


def steps(view: View, repair: str) -> tuple[StepRecord, ...]:
    """Return the steps of a repair, in order."""
    query = select(_STEPS).where(_STEPS.c.repair == checked(repair)).order_by(_STEPS.c.step)
    return tuple(
        StepRecord(row.repair, row.step, row.state, from_json(row.data), row.updated_ns)
        for row in view.rows(query)
    )


def robot_of(view: View, repair: str) -> str:
    """Return the robot that is repaired."""
    query = select(_REPAIRS.c.robot).where(_REPAIRS.c.id == checked(repair))
    return str(view.one(query, f"repair {repair!r}").robot)


def create(
    tx: Transaction,
    robot: str,
    *,
    state: str,
    data: Json,
    open: bool = True,
    fence: Fence | None = None,
    change: bool = False,
) -> StoredRepair:
    """Begin a repair, or a change of configuration. Without a fence it only waits: its owner takes it up."""
    tx.existing(robot)
    if fence is not None:
        tx.check_fence(robot, fence)
    id_, now = new_id(CHANGE if change else "r-"), tx.now_ns
    number = tx.insert(
        _REPAIRS,
        {
            "id": id_,
            "robot": robot,
            "state": checked(state),
            "open": open,
            "data": to_json(data),
            "created_ns": now,
            "updated_ns": now,
        },
    )
    return StoredRepair(id_, number, robot, state, open, data, now, now)


def update(tx: Transaction, repair: str, *, state: str, data: Json, open: bool, fence: Fence) -> StoredRepair:
    """Note what a repair has come to."""
    tx.check_fence(robot_of(tx, repair), fence)
    values = {"state": checked(state), "data": to_json(data), "open": open, "updated_ns": tx.now_ns}
    tx.change(_REPAIRS.update().where(_REPAIRS.c.id == repair), values)
    return get(tx, repair)


def put_step(tx: Transaction, repair: str, step: int, *, state: str, data: Json, fence: Fence) -> None:
    """Note how far a step came."""
    tx.check_fence(robot_of(tx, repair), fence)
    row = {"repair": repair, "step": step, "state": checked(state), "data": to_json(data)}
    tx.replace(_STEPS, row | {"updated_ns": tx.now_ns})


def ask(tx: Transaction, repair: str, what: str, *, by: str, reason: str) -> RepairRequest:
    """Leave a request for the owner of an open repair. StateConflict if it has ended."""
    # Its owner writes intents under the same lock: one comes wholly before the request, or sees it.
    tx.state(robot_of(tx, repair))
    query = select(_REPAIRS).where(_REPAIRS.c.id == checked(repair)).with_for_update(read=True)
    asked = _repair(tx.one(query, f"repair {repair!r}"))
    if not asked.open:
        raise StateConflict(f"repair {repair} has ended: {asked.state}")
    request = RepairRequest(0, repair, asked.robot, checked(what), checked(by), checked(reason), tx.now_ns)
    number = tx.insert(
        _REQUESTS,
        {
            "repair": repair,
            "robot": asked.robot,
            "what": what,
            "by": by,
            "reason": reason,
            "time_ns": tx.now_ns,
            "done": False,
        },
    )
    return replace(request, number=number)


def answer(tx: Transaction, request: int, *, fence: Fence) -> None:
    """Mark a request as done."""
    asked = _request(tx.one(select(_REQUESTS).where(_REQUESTS.c.number == request), f"request {request}"))
    tx.check_fence(asked.robot, fence)
    tx.change(_REQUESTS.update().where(_REQUESTS.c.number == request), {"done": True})


def _repair(row: AnyRow) -> StoredRepair:
    return StoredRepair(
        row.id,
        row.number,
        row.robot,
        row.state,
        row.open,
        from_json(row.data),
        row.created_ns,
        row.updated_ns,
    )


def _request(row: AnyRow) -> RepairRequest:
    return RepairRequest(
        row.number, row.repair, row.robot, row.what, row.by, row.reason, row.time_ns, row.done
    )
