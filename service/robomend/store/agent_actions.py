"""The queue of actions that robots' agents take and answer."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from sqlalchemy import or_, select

from robomend.errors import StateConflict
from robomend.store import schema
from robomend.store.encoding import checked, checked_or_none, from_json, to_json
from robomend.store.records import AgentAction
from robomend.store.rows import AnyRow, View
from robomend.store.transaction import Transaction
from robomend_client.actions import offered

_ACTIONS = schema.agent_actions

HANDED_OUT_NS = 5_000_000_000
"""An action that its agent has not answered for so long is handed to any."""


def get(view: View, action: str) -> AgentAction:
    """Return an action, whether it waits, is with an agent or has its result."""
    return _action(view.one(select(_ACTIONS).where(_ACTIONS.c.id == checked(action)), f"action {action!r}"))


def waiting(view: View, robot: str) -> tuple[AgentAction, ...]:
    """Return the actions without a result, in the order of queueing."""
    query = select(_ACTIONS).where(_ACTIONS.c.robot == checked(robot), _ACTIONS.c.settled_ns.is_(None))
    return tuple(_action(row) for row in view.rows(query.order_by(_ACTIONS.c.number)))


def queue(
    tx: Transaction,
    action: str,
    robot: str,
    *,
    host: str | None,
    name: str,
    parameters: Sequence[str],
    timeout_s: float,
) -> AgentAction:
    """Queue an action for an agent. One with this id that is there already is returned as it is."""
    tx.existing(robot)
    row = tx.first(select(_ACTIONS).where(_ACTIONS.c.id == checked(action)))
    if row is not None:
        return _action(row)
    tx.insert(
        _ACTIONS,
        {
            "id": action,
            "robot": robot,
            "host": checked_or_none(host),
            "name": checked(name),
            "parameters": to_json(list(parameters)),
            "timeout_s": timeout_s,
            "queued_ns": tx.now_ns,
            "expires_ns": tx.now_ns + int(timeout_s * 1e9),
            "answered": False,
            "message": "",
        },
    )
    return get(tx, action)


def meant_for(action: AgentAction, host: str | None, can: Collection[str] | None) -> bool:
    """Return whether an agent may have this action.

    Args:
        host: the agent's; an action for a host goes to that host only.
        can: what the agent can do (robomend_client.actions.offered); None: all.
    """
    if action.host is not None and action.host != host:
        return False
    return offered(can, action.name, action.parameters)


def take(
    tx: Transaction, robot: str, *, host: str | None, agent: str, can: Collection[str] | None = None
) -> AgentAction | None:
    """Hand out the oldest action of the robot that has no answer and is meant for this agent.

    It is handed out again, to the agent that has it, until its first feedback or result: an answer lost
    on the way loses no action.
    """
    table, now = _ACTIONS, tx.now_ns
    free = (
        select(table)
        .where(
            table.c.robot == checked(robot),
            table.c.settled_ns.is_(None),
            ~table.c.answered,
            table.c.expires_ns > now,
            or_(
                table.c.taken_by.is_(None),
                table.c.taken_by == checked(agent),
                table.c.taken_ns < now - HANDED_OUT_NS,
            ),
        )
        .order_by(table.c.number)
    )
    for row in tx.rows(free):
        # Only the one that is taken is locked: an agent that looks at the same time finds the others.
        if meant_for(_action(row), host, can) and tx.first(
            free.where(table.c.id == row.id).with_for_update(skip_locked=True)
        ):
            tx.change(table.update().where(table.c.id == row.id), {"taken_by": agent, "taken_ns": now})
            return replace(_action(row), taken_by=agent, taken_ns=now)
    return None


def answer(tx: Transaction, action: str) -> AgentAction:
    """Note the agent's first sign (feedback). StateConflict after the result."""
    found = _locked(tx, action)
    if found.settled_ns is not None:
        raise StateConflict(f"action {action} has its result already")
    tx.change(_ACTIONS.update().where(_ACTIONS.c.id == action), {"answered": True})
    return replace(found, answered=True)


def finish(tx: Transaction, action: str, code: int, message: str) -> AgentAction:
    """Keep the result; a second one changes nothing and returns the first."""
    found = _locked(tx, action)
    return found if found.settled_ns is not None else _end(tx, found, code, message, answered=True)


def withdraw(tx: Transaction, action: str, code: int, message: str) -> AgentAction:
    """Give an action that no agent has answered this result, so that it is not handed out any more."""
    found = _locked(tx, action)
    if found.settled_ns is not None:
        return found
    if found.answered:
        raise StateConflict(f"action {action} is with an agent already; wait for its result")
    return _end(tx, found, code, message, answered=False)


def _locked(tx: Transaction, action: str) -> AgentAction:
    query = select(_ACTIONS).where(_ACTIONS.c.id == checked(action)).with_for_update()
    return _action(tx.one(query, f"action {action!r}"))


def _end(tx: Transaction, found: AgentAction, code: int, message: str, *, answered: bool) -> AgentAction:
    now = tx.now_ns
    result = {"code": code, "message": checked(message), "settled_ns": now, "answered": answered}
    tx.change(_ACTIONS.update().where(_ACTIONS.c.id == found.id), result)
    return replace(found, code=code, message=message, settled_ns=now, answered=answered)


def _action(row: AnyRow) -> AgentAction:
    return AgentAction(
        id=row.id,
        robot=row.robot,
        host=row.host,
        name=row.name,
        parameters=tuple(from_json(row.parameters)),
        timeout_s=row.timeout_s,
        queued_ns=row.queued_ns,
        expires_ns=row.expires_ns,
        taken_by=row.taken_by,
        taken_ns=row.taken_ns,
        answered=row.answered,
        code=row.code,
        message=row.message,
        settled_ns=row.settled_ns,
    )
