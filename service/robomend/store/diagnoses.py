"""Diagnoses: each that differs from the one before it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from robomend.store.encoding import checked_ns, from_json
from robomend.store.records import FIRST_PAGE, Json, Page, Paging, StoredDiagnosis
from robomend.store.rows import DIAGNOSED, DIAGNOSES, AnyRow, Logged, View, as_it_is, texts_of
from robomend.store.transaction import Transaction
from robomend_client.events import Kind

_ONE = Paging(limit=1)


def latest(view: View, robot: str) -> StoredDiagnosis | None:
    """Return the latest diagnosis."""
    return next(iter(page(view, robot, _ONE).items), None)


def page(view: View, robot: str, paging: Paging = FIRST_PAGE) -> Page[StoredDiagnosis]:
    """Return the diagnoses, newest first."""
    rows = view.newest_of_log(robot, DIAGNOSES, as_it_is, paging)
    return Page(_diagnoses(view, rows.items), rows.next)


def between(
    view: View, robot: str, start_ns: int, end_ns: int, most: int
) -> tuple[tuple[StoredDiagnosis, ...], bool]:
    """Return the one that held at the start and those until the end, oldest first; at most so many.

    And whether these are all: where there are more, it is the newest that are returned.
    """
    before_end = Paging(limit=most, until_ns=checked_ns(end_ns))
    newest = view.newest_of_log(robot, DIAGNOSES, as_it_is, before_end).items
    rows = [row for row in newest if row.time_ns >= start_ns]
    complete = len(rows) < len(newest) or len(newest) < most
    rows += newest[len(rows) : len(rows) + 1]
    return _diagnoses(view, rows[::-1]), complete


def record(tx: Transaction, robot: str, revision: int, result: Json) -> None:
    """Keep a diagnosis that differs from the one before, with its event; that of a batch which was kept just
    before, in its row.
    """
    log, tell = tx.waiting.log, ((Kind.DIAGNOSIS, result),)
    own, digest = tx.waiting.kept(result)
    before = log[-1] if log else None
    if before is not None and before.is_batch(robot, revision):
        before.diagnosed(own, digest, tell)
    else:
        tx.existing(robot)
        log.append(Logged(DIAGNOSED, robot, checked_ns(revision), None, own, digest, tell))


def _diagnoses(view: View, rows: Sequence[AnyRow]) -> tuple[StoredDiagnosis, ...]:
    text = texts_of(view, rows)
    return tuple(_diagnosis(row, from_json(text(row.data, row.common))) for row in rows)


def _diagnosis(row: AnyRow, result: dict[str, Any]) -> StoredDiagnosis:
    return StoredDiagnosis(row.robot, row.revision, result.get("model_version") or "", row.time_ns, result)
