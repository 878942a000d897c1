"""What diagnoses say, once for all rows that say the same.

Robots of one model meet each other's states, and a robot its own of before: of a diagnosis and its event, all
but the revision and the time is a text that is in the table `results` already. The rows have its number.

A result stays as long as a row may have its number: `used_day` is the latest day on which one was written,
and grows only, whatever the clock does. Pruning (pruning.py) moves it on for rows that stay though they are
old, and removes what was not used for longer than any row is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from sqlalchemy import Executable, bindparam, select, text

from robomend.errors import StoreError
from robomend.store import schema
from robomend.store.driver import DriverConnection
from robomend.store.encoding import filled
from robomend.store.prepared import Prepared
from robomend.store.view import AnyRow, View

DAY_NS = 86_400_000_000_000
REMOVALS = "results-removed"
"""The counter of removals: while it stands, the numbers that somebody knows are right (known.py)."""
_SOME = 500

_RESULTS = schema.results
_LOOK = "SELECT digest, number, used_day, (SELECT max(used_day) FROM results) FROM results WHERE digest"
_FIND = {"sqlite": f"{_LOOK} IN ({{keys}})", "postgresql": f"{_LOOK} = ANY($1)"}
_TEXTS = select(_RESULTS.c.number, _RESULTS.c.data).where(
    _RESULTS.c.number.in_(bindparam("numbers", expanding=True))
)


def _keep(kind: str) -> Executable:
    """Return the statement that keeps a result, or says that it is used today; it returns the number."""
    later = "max" if kind == "sqlite" else "greatest"
    return text(
        "INSERT INTO results (digest, data, used_day)"
        f" VALUES (:digest, :data, {later}((SELECT coalesce(max(used_day), 0) FROM results), :today))"
        f" ON CONFLICT (digest) DO UPDATE SET used_day = {later}(results.used_day, excluded.used_day)"
        " RETURNING number"
    )


_KEEP = Prepared(_keep, ("digest", "data", "today"))


def number(driver: DriverConnection, texts: Mapping[str, str], now_ns: int) -> dict[str, int]:
    """Return the number of each text, by its digest; what is not there yet is kept."""
    today = now_ns // DAY_NS
    numbers: dict[str, int] = {}
    digests = sorted(texts)  # one order, so that instances do not wait for each other in a circle
    for start in range(0, len(digests), _SOME):
        some = digests[start : start + _SOME]
        look = driver.select_in(_FIND, [*map(bytes.fromhex, some)])
        for digest, found, used_day, newest in look.fetchall():
            if used_day >= max(today, newest):
                numbers[digest.hex()] = found
        missing = [digest for digest in some if digest not in numbers]
        kept = [
            _KEEP.later(driver, (bytes.fromhex(digest), schema.packed(texts[digest]), today))
            for digest in missing
        ]
        numbers.update((digest, found()) for digest, found in zip(missing, kept, strict=True))
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
