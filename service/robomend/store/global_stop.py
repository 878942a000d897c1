"""The global stop: after it is set, no instance sends an action.

On PostgreSQL it is locked besides (there may be no row to lock yet): whoever sets it waits for those who have
read that there is none and still write an intent. On SQLite one writes at a time anyway.
"""

from __future__ import annotations

from dataclasses import asdict

from sqlalchemy import select, text

from robomend.store import schema
from robomend.store.encoding import from_json, to_json
from robomend.store.records import Stop
from robomend.store.rows import View
from robomend.store.transaction import Transaction

_STOP = select(schema.settings.c.value).where(schema.settings.c.name == "stop")  # each second: made once
_LOCK = 0x73746F70  # "stop": PostgreSQL's advisory lock


def get(view: View) -> Stop:
    """Return the stop as it is on disk."""
    rows = view.rows(_STOP)
    return Stop(**from_json(rows[0].value)) if rows else Stop()


def hold(tx: Transaction) -> Stop:
    """Return the stop, and keep it as it is until this transaction ends."""
    _lock(tx, "pg_advisory_xact_lock_shared")
    return get(tx)


def put(tx: Transaction, active: bool, *, by: str, reason: str) -> Stop:
    """Set the stop, or lift it."""
    _lock(tx, "pg_advisory_xact_lock")
    stop = Stop(active, by, reason, tx.now_ns, get(tx).revision + 1)
    tx.replace(schema.settings, {"name": "stop", "value": to_json(asdict(stop))})
    return stop


def _lock(tx: Transaction, how: str) -> None:
    if tx.connection.dialect.name == "postgresql":
        tx.connection.execute(text(f"SELECT {how}(:key)"), {"key": _LOCK})
