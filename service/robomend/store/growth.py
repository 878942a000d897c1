"""How fast the database grows: measured on what was written last."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

from sqlalchemy import func, select

from robomend.store import schema
from robomend.store.records import Retention
from robomend.store.results import DAY_NS
from robomend.store.rows import CHANGE, DIAGNOSED, OBSERVED
from robomend.store.view import View

LOOK = 20_000
"""Rows of the log that are looked at, the newest."""

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
    rows = view.rows(select(*columns).order_by(log.id.desc()).limit(LOOK))
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
