"""Durable memory: everything that must survive a power cut, in SQLite or PostgreSQL.

`Store(url)` in store.py is where to begin: functions of a snapshot to read, of a transaction to write.

    store.py         Store: reading, writing, the event log as it grows
    records.py       the frozen values that are kept
    schema.py        the tables;  encoding.py  values to columns;  migrations/  older databases
    view.py          View: what a query reads;  transaction.py  Transaction: what a change writes
    group.py         the database transaction that changes share;  rows.py  what waits in memory until its end
    events.py        the log: batches, diagnoses and all other events, as they are read
    batch_text.py    a batch in it;  folding.py  OBS: rows, and the batches that came since
    models.py, robots.py, observations.py, start_ups.py, diagnoses.py, repairs.py, journal.py, attempts.py,
    drills.py, moments.py, batch_jobs.py, agent_actions.py, api_keys.py, global_stop.py, audit.py,
    notifications.py
                     each subject: functions of a View that read it, of a Transaction that write it
    results.py       what diagnoses say, once for all rows that say the same
    database.py      connections, and what differs between SQLite and PostgreSQL
    writer.py        one thread that commits in groups
    session.py       the instance's lock and its ear;  ownership.py  one owner per robot, with fencing numbers
    portable.py      export, import and backup;  pruning.py  retention;  growth.py  how fast it grows
"""

from __future__ import annotations

from robomend.store.store import Store, opened
from robomend.store.transaction import Transaction
from robomend.store.view import View

__all__ = ["Store", "Transaction", "View", "opened"]
