"""How long a robot's nodes took to be heard after they began, of their latest starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from sqlalchemy import select

from robomend.store import schema
from robomend.store.encoding import checked, checked_ns, from_json, to_json
from robomend.store.records import StoredStart
from robomend.store.rows import View
from robomend.store.transaction import Transaction

_START_UPS = schema.start_ups


def of(view: View, robot: str) -> dict[str, tuple[StoredStart, ...]]:
    """Return topic -> its publisher's latest starts."""
    query = select(_START_UPS.c.topic, _START_UPS.c.took).where(_START_UPS.c.robot == checked(robot))
    return {row.topic: tuple(map(_start, from_json(row.took))) for row in view.rows(query)}


def keep(tx: Transaction, robot: str, took: Mapping[str, Sequence[StoredStart]]) -> None:
    """Keep these starts in place of what was kept of these topics; of an empty one, nothing."""
    table = _START_UPS
    for topic, starts in took.items():
        if starts:
            values = to_json([_json(start) for start in starts])
            tx.replace(table, {"robot": checked(robot), "topic": checked(topic), "took": values})
        else:
            tx.change(table.delete().where(table.c.robot == robot, table.c.topic == checked(topic)))


def _json(start: StoredStart) -> int | list[int]:
    """One that nothing held up is one number, one that a device may have held up has a third."""
    took_ns = checked_ns(start.took_ns)
    return [took_ns, checked_ns(start.own_ns), *([1] if start.powered else [])] if start.held_up else took_ns


def _start(value: int | list[int]) -> StoredStart:
    if isinstance(value, int):
        return StoredStart(value, value, False)
    took_ns, own_ns, *powered = value
    return StoredStart(took_ns, own_ns, True, bool(powered))
