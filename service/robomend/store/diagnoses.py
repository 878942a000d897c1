"""Diagnoses: each that differs from the one before it."""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy import select

from robomend.store import results, schema
from robomend.store.encoding import checked, checked_ns, from_json
from robomend.store.records import FIRST_PAGE, Json, Page, Paging, StoredDiagnosis
from robomend.store.transaction import Transaction
from robomend.store.view import AnyRow, View

_DIAGNOSES = schema.diagnoses


def latest(view: View, robot: str) -> StoredDiagnosis | None:
    """Return the latest diagnosis."""
    of_robot = select(_DIAGNOSES).where(_DIAGNOSES.c.robot == checked(robot))
    row = view.first(of_robot.order_by(_DIAGNOSES.c.number.desc()))
    return None if row is None else _diagnoses(view, [row])[0]


def page(view: View, robot: str, paging: Paging = FIRST_PAGE) -> Page[StoredDiagnosis]:
    """Return the diagnoses, newest first."""
    rows = view.newest_first(_DIAGNOSES, _as_it_is, paging, _DIAGNOSES.c.robot == checked(robot))
    return Page(_diagnoses(view, rows.items), rows.next)


def between(
    view: View, robot: str, start_ns: int, end_ns: int, most: int
) -> tuple[tuple[StoredDiagnosis, ...], bool]:
    """Return the one that held at the start and those until the end, oldest first; at most so many.

    And whether these are all: where there are more, it is the newest that are returned.
    """
    of_robot = select(_DIAGNOSES).where(
        _DIAGNOSES.c.robot == checked(robot), _DIAGNOSES.c.time_ns < checked_ns(end_ns)
    )
    newest = view.rows(of_robot.order_by(_DIAGNOSES.c.number.desc()).limit(most))
    rows = [row for row in newest if row.time_ns >= start_ns]
    complete = len(rows) < len(newest) or len(newest) < most
    rows += newest[len(rows) : len(rows) + 1]
    return _diagnoses(view, rows[::-1]), complete


def record(tx: Transaction, robot: str, revision: int, result: Json, *, model_version: str = "") -> None:
    """Keep a diagnosis that differs from the one before."""
    tx.existing(robot)
    waiting = tx.waiting
    of_revision = (robot, checked_ns(revision), checked(model_version), tx.now_ns)
    waiting.diagnoses.append((*of_revision, *waiting.kept(result)))


def _diagnoses(view: View, rows: Sequence[AnyRow]) -> tuple[StoredDiagnosis, ...]:
    text = results.texts_of(view, rows)
    return tuple(
        StoredDiagnosis(
            row.robot, row.revision, row.model_version, row.time_ns, from_json(text(row.result, row.common))
        )
        for row in rows
    )


def _as_it_is(row: AnyRow) -> AnyRow:
    return row
