"""The audit log, as it is read; `Transaction.note` writes it."""

from __future__ import annotations

from robomend.store import schema
from robomend.store.encoding import checked, from_json
from robomend.store.records import FIRST_PAGE, AuditEntry, Page, Paging
from robomend.store.rows import AnyRow, View


def page(
    view: View,
    paging: Paging = FIRST_PAGE,
    *,
    robot: str | None = None,
    actor: str | None = None,
    action: str | None = None,
    subject: str | None = None,
    without: tuple[str, ...] = (),
) -> Page[AuditEntry]:
    """Return the audit log, newest first; `without` are actors and actions that are left out."""
    table = schema.audit
    wanted = (
        (table.c.robot, robot),
        (table.c.actor, actor),
        (table.c.action, action),
        (table.c.subject, subject),
    )
    where = [column == checked(value) for column, value in wanted if value is not None]
    if without:
        where += [table.c.actor.not_in(without), table.c.action.not_in(without)]
    return view.newest_first(table, _entry, paging, *where, key="id")


def _entry(row: AnyRow) -> AuditEntry:
    before, after = (None if text is None else from_json(text) for text in (row.before, row.after))
    return AuditEntry(
        row.actor, row.action, row.subject, row.robot, row.reason, before, after, row.time_ns, row.id
    )
