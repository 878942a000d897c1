"""The action journal: an intent is written before an action is sent, and its outcome after.

Writes carry a fence, see repairs.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sqlalchemy import select

from robomend.errors import StateConflict
from robomend.store import repairs, schema
from robomend.store.encoding import checked, from_json, to_json
from robomend.store.records import Fence, Intent
from robomend.store.rows import AnyRow, View
from robomend.store.transaction import Transaction

_JOURNAL = schema.journal


def get(view: View, action: str) -> Intent:
    """Return the entry of an action."""
    return _intent(view.one(select(_JOURNAL).where(_JOURNAL.c.id == checked(action)), f"action {action!r}"))


def unsettled(view: View, robot: str) -> tuple[Intent, ...]:
    """Return the intents whose outcome is unknown: what a crash left behind."""
    query = select(_JOURNAL).where(_JOURNAL.c.robot == checked(robot), _JOURNAL.c.settled_ns.is_(None))
    return tuple(_intent(row) for row in view.rows(query.order_by(_JOURNAL.c.number)))


def intend(
    tx: Transaction,
    repair: str,
    step: int,
    *,
    action: str,
    name: str,
    parameters: Sequence[str],
    timeout_s: float,
    fence: Fence,
) -> Intent:
    """Journal that an action will be sent. StateConflict if the action id was used before."""
    robot = repairs.robot_of(tx, repair)
    tx.check_fence(robot, fence)
    if tx.first(select(_JOURNAL.c.id).where(_JOURNAL.c.id == checked(action))) is not None:
        raise StateConflict(f"the action id {action} was used before; an id acts once")
    tx.insert(
        _JOURNAL,
        {
            "id": action,
            "repair": repair,
            "step": step,
            "robot": robot,
            "name": checked(name),
            "parameters": to_json(list(parameters)),
            "timeout_s": timeout_s,
            "fence": fence.number,
            "intended_ns": tx.now_ns,
            "message": "",
        },
    )
    return get(tx, action)


def settle(tx: Transaction, action: str, code: int, message: str = "", *, fence: Fence) -> Intent:
    """Journal an outcome. A second one changes nothing and returns the first."""
    intent = get(tx, action)
    tx.check_fence(intent.robot, fence)
    if intent.settled_ns is not None:
        return intent
    outcome = {"code": code, "message": checked(message), "settled_ns": tx.now_ns}
    tx.change(_JOURNAL.update().where(_JOURNAL.c.id == action), outcome)
    return replace(intent, code=code, message=message, settled_ns=tx.now_ns)


def _intent(row: AnyRow) -> Intent:
    return Intent(
        id=row.id,
        repair=row.repair,
        step=row.step,
        robot=row.robot,
        name=row.name,
        parameters=tuple(from_json(row.parameters)),
        timeout_s=row.timeout_s,
        fence=row.fence,
        intended_ns=row.intended_ns,
        code=row.code,
        message=row.message,
        settled_ns=row.settled_ns,
    )
