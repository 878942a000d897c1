"""How long a robot's nodes took to be heard after they began, of their latest starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from sqlalchemy import select

from robomend.store import schema
from robomend.store.encoding import checked, checked_ns, from_json, to_json
from robomend.store.transaction import Transaction
from robomend.store.view import View

_START_UPS = schema.start_ups


def of(view: View, robot: str) -> dict[str, tuple[int, ...]]:
    """Return topic -> how long its publisher's latest starts took, in nanoseconds."""
    query = select(_START_UPS.c.topic, _START_UPS.c.took).where(_START_UPS.c.robot == checked(robot))
    return {row.topic: tuple(from_json(row.took)) for row in view.rows(query)}


def keep(tx: Transaction, robot: str, took: Mapping[str, Sequence[int]]) -> None:
    """Keep what starts took in place of what was kept of these topics; of an empty one, nothing."""
    table = _START_UPS
    for topic, times in took.items():
        if times:
            values = to_json([checked_ns(time_ns) for time_ns in times])
            tx.replace(table, {"robot": checked(robot), "topic": checked(topic), "took": values})
        else:
            tx.change(table.delete().where(table.c.robot == robot, table.c.topic == checked(topic)))
