"""What diagnoses say, once for all rows that say the same.

Robots of one model meet each other's states, and a robot its own of before: of a diagnosis and its event, all
but the revision and the time is a text that is in the table `results` already. The rows have its number.

A result stays as long as a row may have its number: `used_day` is the latest day on which one was written,
and grows only, whatever the clock does. Pruning (pruning.py) moves it on for rows that stay though they are
old, and removes what was not used for longer than any row is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from sqlalchemy import Connection, Executable, bindparam, func, select
from sqlalchemy.dialects import postgresql, sqlite

from robomend.errors import StoreError
from robomend.store import schema
from robomend.store.encoding import filled
from robomend.store.view import AnyRow, View

DAY_NS = 86_400_000_000_000
_SOME = 500

_RESULTS = schema.results
_NEWEST_DAY = select(func.coalesce(func.max(_RESULTS.c.used_day), 0)).scalar_subquery()
_LOOK = select(_RESULTS.c.digest, _RESULTS.c.number, _RESULTS.c.used_day, _NEWEST_DAY.label("newest")).where(
    _RESULTS.c.digest.in_(bindparam("digests", expanding=True))
)
_TEXTS = select(_RESULTS.c.number, _RESULTS.c.data).where(
    _RESULTS.c.number.in_(bindparam("numbers", expanding=True))
)


def _keep(kind: str) -> Executable:
    """Return the statement that keeps a result, or says that it is used today; it returns the number."""
    insert: sqlite.Insert | postgresql.Insert = (
        sqlite.insert(_RESULTS) if kind == "sqlite" else postgresql.insert(_RESULTS)
    )
    later = func.max if kind == "sqlite" else func.greatest
    insert = insert.values(used_day=later(_NEWEST_DAY, bindparam("today")))
    used = {"used_day": later(_RESULTS.c.used_day, insert.excluded.used_day)}
    return insert.on_conflict_do_update(index_elements=["digest"], set_=used).returning(_RESULTS.c.number)


_KEEP = {kind: _keep(kind) for kind in ("sqlite", "postgresql")}


def number(connection: Connection, texts: Mapping[str, str], now_ns: int) -> dict[str, int]:
    """Return the number of each text, by its digest; what is not there yet is kept."""
    today = now_ns // DAY_NS
    numbers: dict[str, int] = {}
    digests = sorted(texts)  # one order, so that instances do not wait for each other in a circle
    for start in range(0, len(digests), _SOME):
        some = digests[start : start + _SOME]
        for row in connection.execute(_LOOK, {"digests": some}):
            if row.used_day >= max(today, row.newest):
                numbers[row.digest] = row.number
        for digest in some:
            if digest not in numbers:
                kept = {"digest": digest, "data": texts[digest], "today": today}
                numbers[digest] = connection.execute(_KEEP[connection.dialect.name], kept).scalar_one()
    return numbers


def texts_of(view: View, rows: Iterable[AnyRow]) -> Callable[[str, int | None], str]:
    """Return what makes the text of one of these rows, from what it keeps itself and its result's number."""
    numbers = sorted({row.common for row in rows if row.common is not None})
    found: dict[int, str] = {}
    for start in range(0, len(numbers), _SOME):
        some = numbers[start : start + _SOME]
        found.update((row.number, row.data) for row in view.rows(_TEXTS.params(numbers=some)))

    def whole(own: str, common: int | None) -> str:
        if common is None:
            return own
        if common not in found:
            raise StoreError(f"the result {common} of a diagnosis is missing in the database")
        return filled(own, found[common])

    return whole
