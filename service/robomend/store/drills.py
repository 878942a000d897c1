"""Drills: which fault is planted on which robot, how far it has come, and what is asked of it.

What the owner writes carries its fence, as repairs do (see repairs.py).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict

from sqlalchemy import select

from robomend.errors import StateConflict
from robomend.store import schema
from robomend.store.encoding import checked, from_json, new_id, to_json
from robomend.store.records import FIRST_PAGE, DrillRequest, Fence, Json, Page, Paging, StoredDrill
from robomend.store.rows import AnyRow, View
from robomend.store.transaction import Transaction

_DRILLS = schema.drills
_OPEN_ONES = select(_DRILLS).where(_DRILLS.c.open)  # each second: made once


def get(view: View, drill: str) -> StoredDrill:
    """Return a drill."""
    return _drill(view.one(select(_DRILLS).where(_DRILLS.c.id == checked(drill)), f"drill {drill!r}"))


def page(view: View, robot: str, paging: Paging = FIRST_PAGE) -> Page[StoredDrill]:
    """Return a robot's drills, newest first. The cursor may be a drill's id: those older than it."""
    if paging.cursor is not None and not paging.cursor.isdecimal():
        paging = Paging(str(get(view, paging.cursor).number), paging.limit)
    return view.newest_first(_DRILLS, _drill, paging, _DRILLS.c.robot == checked(robot))


def open_of(view: View, robot: str) -> StoredDrill | None:
    """Return the robot's open drill; there is one at a time."""
    row = view.first(select(_DRILLS).where(_DRILLS.c.robot == checked(robot), _DRILLS.c.open))
    return None if row is None else _drill(row)


def open_ones(view: View) -> tuple[StoredDrill, ...]:
    """Return the open drills of all robots."""
    return tuple(_drill(row) for row in view.rows(_OPEN_ONES))


def between(view: View, robot: str, first_ns: int, last_ns: int) -> tuple[StoredDrill, ...]:
    """Return the robot's drills that were open at any moment of that time."""
    went_on = _DRILLS.c.open | (_DRILLS.c.updated_ns >= first_ns)
    of_robot = (_DRILLS.c.robot == checked(robot)) & (_DRILLS.c.created_ns <= last_ns)
    return tuple(_drill(row) for row in view.rows(select(_DRILLS).where(of_robot, went_on)))


def create(tx: Transaction, robot: str, *, state: str, data: Json) -> StoredDrill:
    """Begin a drill; its owner takes it up. StateConflict while one is open."""
    tx.existing(robot)
    before = open_of(tx, robot)
    if before is not None:
        raise StateConflict(f"drill {before.id} of {robot!r} is {before.state}")
    row = {
        "id": new_id("d-"),
        "robot": robot,
        "state": checked(state),
        "open": True,
        "watched": False,
        "asked": None,
        "data": to_json(data),
        "created_ns": tx.now_ns,
        "updated_ns": tx.now_ns,
    }
    tx.insert(_DRILLS, row)
    return get(tx, str(row["id"]))


def update(
    tx: Transaction,
    drill: str,
    *,
    state: str,
    data: Json,
    open: bool,
    watched: bool,
    fence: Fence,
    answered: Callable[[DrillRequest], bool] | None = None,
) -> StoredDrill:
    """Note what a drill has come to; `answered`: whether a request is done with. A newer one may be there."""
    tx.check_fence(fence.robot, fence)
    values: dict[str, object] = {
        "state": checked(state),
        "data": to_json(data),
        "open": open,
        "watched": watched,
        "updated_ns": tx.now_ns,
    }
    asked = None if answered is None else get(tx, drill).asked
    if answered is not None and asked is not None and answered(asked):
        values["asked"] = None
    of_robot = (_DRILLS.c.id == checked(drill)) & (_DRILLS.c.robot == fence.robot)
    tx.change(_DRILLS.update().where(of_robot).values(values))
    return get(tx, drill)


def ask(tx: Transaction, drill: str, what: str, *, by: str, reason: str) -> StoredDrill:
    """Leave a request for the owner of an open drill; a newer one takes its place."""
    # The owner writes under the same lock: its writes come wholly before the request, or see it.
    tx.state(get(tx, drill).robot)
    asked = DrillRequest(checked(what), checked(by), checked(reason), tx.now_ns)
    still_open = (_DRILLS.c.id == drill) & _DRILLS.c.open
    if not tx.change(_DRILLS.update().where(still_open).values(asked=to_json(asdict(asked)))):
        raise StateConflict(f"drill {drill} has ended: {get(tx, drill).state}")
    return get(tx, drill)


def _drill(row: AnyRow) -> StoredDrill:
    return StoredDrill(
        row.id,
        row.number,
        row.robot,
        row.state,
        row.open,
        row.watched,
        None if row.asked is None else DrillRequest(**from_json(row.asked)),
        from_json(row.data),
        row.created_ns,
        row.updated_ns,
    )
