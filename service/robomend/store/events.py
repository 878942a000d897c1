"""The event log, as it is read; `Transaction.emit` writes it and tail.py follows it as it grows."""

from __future__ import annotations

from sqlalchemy import func, select

from robomend.store import results, schema
from robomend.store.encoding import Encoded, checked, from_json
from robomend.store.records import EventRange
from robomend.store.view import View
from robomend_client.events import Event, Kind


def after(view: View, last: int, *, robot: str | None = None, limit: int = 500) -> tuple[Event, ...]:
    """Return up to `limit` events with a larger id than `last`, oldest first."""
    table = schema.events
    query = select(table).where(table.c.id > last).order_by(table.c.id).limit(limit)
    if robot is not None:
        query = query.where(table.c.robot == checked(robot))
    rows = view.rows(query)
    text = results.texts_of(view, rows)
    return tuple(
        Event(row.id, row.time_ns, Kind(row.kind), row.robot, _data(text(row.data, row.common)))
        for row in rows
    )


def kept(view: View) -> EventRange:
    """Return which ids are kept; an id below `oldest - 1` has a gap behind it."""
    counters = schema.counters
    newest = view.one(select(counters.c.value).where(counters.c.name == "event"), "event counter").value
    oldest = view.rows(select(func.min(schema.events.c.id)))[0][0]
    return EventRange(oldest=newest + 1 if oldest is None else oldest, newest=newest)


def _data(text: str) -> Encoded:
    return Encoded(from_json(text), text)
