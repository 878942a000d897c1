"""How fast the database grows: measured on what was written last."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

from sqlalchemy import Table, func, select

from robomend.store import schema
from robomend.store.records import Retention
from robomend.store.results import DAY_NS
from robomend.store.view import View

LOOK = 20_000
"""Rows of each log that are looked at, the newest."""

ROW = 40
"""Bytes that a row takes beside its texts, with its places in indexes, about."""

LEAST_DAYS = 1 / 144
"""Ten minutes: a shorter history says nothing of a day."""


@dataclass(frozen=True, slots=True)
class Growth:
    """Bytes a day, by what was written in the last day of the history."""

    days: float  # how much of a day the figures are of
    robots: Mapping[str, float]  # of each that something was written about
    logs: Mapping[str, float]  # of each log, and of the results that diagnoses share

    @property
    def bytes_a_day(self) -> float:
        """All of it."""
        return sum(self.logs.values())

    def kept(self, retention: Retention) -> float | None:
        """Return how large the logs become until what is written is what goes; None: without an end."""
        both = _longer(retention.diagnoses_days, retention.events_days)
        days = {
            "observations": retention.observations_days,
            "diagnoses": retention.diagnoses_days,
            "events": retention.events_days,
            "results": both,
        }
        total = 0.0
        for log, bytes_a_day in self.logs.items():
            kept = days[log]
            if kept is None:
                return None
            total += bytes_a_day * kept
        return total


def measure(view: View, now_ns: int) -> Growth:
    """Return what the last day of the history grew by, as far as the newest rows of each log tell.

    Robots of one model share results, so what a result takes is not any robot's; all that were met count, as
    if none had been there before.
    """
    robots: defaultdict[str, float] = defaultdict(float)
    logs: dict[str, float] = {}
    newest_ns = max(_newest_ns(view, table) for table in _LOGS)
    end_ns = now_ns if now_ns - newest_ns < DAY_NS else newest_ns
    longest = 0.0
    for table, text in _LOGS.items():
        size = func.length(table.c[text]).label("size")
        common = table.c.common if "common" in table.c else None
        columns = [table.c.robot, table.c.time_ns, size, *([] if common is None else [common])]
        key = next(iter(table.primary_key))
        rows = view.rows(select(*columns).order_by(key.desc()).limit(LOOK))
        young = [row for row in rows if row.time_ns > end_ns - DAY_NS]
        whole_day = len(young) < len(rows)
        days = 1.0 if whole_day or not rows else (end_ns - rows[-1].time_ns) / DAY_NS
        days = max(LEAST_DAYS, min(1.0, days))
        longest = max(longest, days if rows else 0.0)
        for row in young:
            if row.robot is not None:
                robots[row.robot] += (row.size + ROW) / days
        logs[table.name] = sum(row.size + ROW for row in young) / days
        if common is not None:
            shared = _bytes_of(view, {row.common for row in young if row.common is not None}) / days
            logs["results"] = max(logs.get("results", 0.0), shared)
    return Growth(longest, dict(robots), logs)


_LOGS: Mapping[Table, str] = {
    schema.observations: "data",
    schema.diagnoses: "result",
    schema.events: "data",
}
"""And the text that a row of it has."""


def _newest_ns(view: View, table: Table) -> int:
    key = next(iter(table.primary_key))
    row = view.first(select(table.c.time_ns).order_by(key.desc()))
    return 0 if row is None else int(row.time_ns)


def _bytes_of(view: View, results: set[int]) -> float:
    table, numbers, total = schema.results, sorted(results), 0.0
    for start in range(0, len(numbers), 500):
        size = select(func.length(table.c.data).label("size"))
        rows = view.rows(size.where(table.c.number.in_(numbers[start : start + 500])))
        total += sum(row.size + ROW for row in rows)
    return total


def _longer(one: float | None, other: float | None) -> float | None:
    return None if one is None or other is None else max(one, other)
