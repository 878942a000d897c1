"""The log, as it is read: events in the order of their ids. `Transaction.emit`, observations.py and
diagnoses.py write it, and store.py follows it as it grows.

A row that is a batch and its diagnosis is two events; it has the id of the second. How long a row is kept
goes by its kind (pruning.py); the log begins where all kinds are there, behind the cut.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import islice

from sqlalchemy import func, select

from robomend.store import schema
from robomend.store.encoding import Encoded, checked, event_of, from_json
from robomend.store.records import EventRange
from robomend.store.rows import CHANGE, AnyRow, View, texts_of
from robomend_client.events import Event, Kind

CUT = "events-cut"
"""The counter of the id up to which events were removed."""

KINDS = (*Kind, CHANGE)

_LOG, _COUNTERS = schema.events, schema.counters


def after(view: View, last: int, *, robot: str | None = None, limit: int = 500) -> tuple[Event, ...]:
    """Return up to `limit` events with a larger id than `last`, oldest first."""
    last = max(last, counter(view, CUT))
    query = select(_LOG).where(_LOG.c.id > last).order_by(_LOG.c.id).limit(limit)
    if robot is None:
        rows = view.of_log(query)
    else:  # the index has them in their order, kind by kind
        of_robot = query.where(_LOG.c.robot == checked(robot))
        found = [row for kind in KINDS for row in view.of_log(of_robot.where(_LOG.c.kind == kind))]
        rows = sorted(found, key=lambda row: row.id)[:limit]
    text = texts_of(view, rows)
    return tuple(islice((event for event in _events(rows, text) if event.id > last), limit))


def kept(view: View) -> EventRange:
    """Return which ids are kept; an id below `oldest - 1` has a gap behind it."""
    in_log = view.of_log(select(func.max(_LOG.c.id)))[0][0]
    return EventRange(oldest=counter(view, CUT) + 1, newest=max(counter(view, "event"), in_log or 0))


def counter(view: View, name: str) -> int:
    """Return what a counter is at."""
    row = view.first(select(_COUNTERS.c.value).where(_COUNTERS.c.name == name))
    return 0 if row is None else int(row.value)


def _events(rows: Iterable[AnyRow], text: Callable[[str, int | None], str]) -> Iterator[Event]:
    for row in rows:
        change = row.kind == CHANGE
        if row.data is None or change:
            told = event_of(row.batch, row.revision, row.time_ns)
            yield Event(row.id - change, row.time_ns, Kind.OBSERVATIONS, row.robot, told)
        if row.data is not None:
            kind = Kind.DIAGNOSIS if change else Kind(row.kind)
            yield Event(row.id, row.time_ns, kind, row.robot, _data(text(row.data, row.common)))


def _data(text: str) -> Encoded:
    return Encoded(from_json(text), text)
