"""What people are told, per recipient, until it has arrived; and how far the event log was looked through."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

from sqlalchemy import func, select

from robomend.store import schema
from robomend.store.encoding import checked, from_json, to_json
from robomend.store.records import FIRST_PAGE, Json, Page, Paging, StoredNotification
from robomend.store.rows import AnyRow, View
from robomend.store.transaction import Transaction

_TOLD = schema.notifications
_COUNTERS = schema.counters

CURSOR = "notified"
"""The counter that holds the last event that was looked at."""

_LOOKED = select(_COUNTERS.c.value).where(_COUNTERS.c.name == CURSOR)

SAME_NS = 3_600_000_000_000
"""What was told is not told again to the same recipient for so long."""

MOST_WAITING = 1000
"""For one recipient; what comes then is not kept for it."""

CLAIMED_NS = 120_000_000_000
"""Whoever sends it has so long; then it is due again."""


def looked_to(view: View) -> int | None:
    """Return the last event that was looked at; None: nobody has begun to."""
    row = view.first(_LOOKED)
    return None if row is None else int(row.value)


def look_to(tx: Transaction, event: int) -> int | None:
    """Note that the event log was looked through up to this event, never back, and return up to which
    it was: no other instance looks further until this transaction has ended.
    """
    row = tx.first(_LOOKED.with_for_update())
    before = None if row is None else int(row.value)
    if before is None or event > before:
        tx.replace(_COUNTERS, {"name": CURSOR, "value": event})
    return before


def forget(tx: Transaction) -> None:
    """There is nobody to tell: whoever comes later is not told of what was."""
    tx.change(_COUNTERS.delete().where(_COUNTERS.c.name == CURSOR))


def tell(tx: Transaction, recipient: str, key: str, data: Json) -> int | None:
    """Keep something to be told at once, and return its number.

    None: it was told lately, or too much waits for this recipient already.
    """
    table = _TOLD
    mine = table.c.recipient == checked(recipient)
    same = select(table.c.number).where(
        table.c.key == checked(key), mine, table.c.created_ns > tx.now_ns - SAME_NS
    )
    if tx.first(same) is not None:
        return None
    waiting = tx.rows(select(func.count()).where(mine, table.c.due_ns.is_not(None)))[0][0]
    if waiting >= MOST_WAITING:
        return None
    values = {"recipient": recipient, "key": key, "data": to_json(dict(data)), "created_ns": tx.now_ns}
    return tx.insert(table, {**values, "tries": 0, "due_ns": tx.now_ns, "state": "waiting", "answer": ""})


def due(tx: Transaction, recipient: str, limit: int) -> tuple[StoredNotification, ...]:
    """Claim what is due for a recipient: whoever asks next does not get it before CLAIMED_NS is over."""
    query = select(_TOLD).where(_TOLD.c.due_ns <= tx.now_ns, _TOLD.c.recipient == recipient)
    found = tx.rows(query.order_by(_TOLD.c.number).limit(limit).with_for_update(skip_locked=True))
    _change(tx, [row.number for row in found], due_ns=tx.now_ns + CLAIMED_NS)
    return tuple(_notification(row) for row in found)


def delivered(tx: Transaction, numbers: Sequence[int], answer: str) -> None:
    """They have arrived."""
    _change(tx, numbers, tries=_TOLD.c.tries + 1, state="delivered", answer=answer, due_ns=None)


def put_off(tx: Transaction, numbers: Sequence[int], answer: str, *, by_ns: int) -> None:
    """They did not arrive; another try is due later."""
    _change(tx, numbers, tries=_TOLD.c.tries + 1, answer=answer, due_ns=tx.now_ns + by_ns)


def give_up(tx: Transaction, numbers: Sequence[int], answer: str) -> None:
    """They did not arrive, and are not tried again."""
    _change(tx, numbers, tries=_TOLD.c.tries + 1, state="given-up", answer=answer, due_ns=None)


def next_due(view: View) -> dict[str, int]:
    """Return when something is due next, for each recipient for whom something is."""
    query = select(_TOLD.c.recipient, func.min(_TOLD.c.due_ns).label("due_ns"))
    return {
        row.recipient: int(row.due_ns)
        for row in view.rows(query.where(_TOLD.c.due_ns.is_not(None)).group_by(_TOLD.c.recipient))
    }


def disown(tx: Transaction, known: Collection[str], answer: str) -> None:
    """Give up what waits for recipients that are not known any more."""
    gone = select(_TOLD.c.number).where(_TOLD.c.due_ns.is_not(None), _TOLD.c.recipient.not_in(list(known)))
    give_up(tx, [row.number for row in tx.rows(gone)], answer)


def get(view: View, number: int) -> StoredNotification:
    """Return one."""
    return _notification(view.one(select(_TOLD).where(_TOLD.c.number == number), f"notification n-{number}"))


def page(view: View, paging: Paging = FIRST_PAGE) -> Page[StoredNotification]:
    """Return them, newest first."""
    return view.newest_first(_TOLD, _notification, paging)


def _change(tx: Transaction, numbers: Iterable[int], **values: object) -> None:
    tx.change(_TOLD.update().where(_TOLD.c.number.in_(list(numbers))).values(**values))


def _notification(row: AnyRow) -> StoredNotification:
    return StoredNotification(
        row.number,
        row.recipient,
        from_json(row.data),
        row.created_ns,
        row.tries,
        row.due_ns,
        row.state,
        row.answer,
    )
