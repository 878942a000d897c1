"""Durable memory: everything that must survive a power cut, in SQLite or PostgreSQL.

`Store(url)` in store.py is where to begin: functions of a snapshot to read, of a transaction to write.

    store.py         Store: reading, writing, the event log as it grows
    records.py       the frozen values that are kept
    schema.py        the tables;  migrations/  older databases
    encoding.py      values to columns, and a batch as the log keeps it;  folding.py  OBS of rows and batches
    rows.py          View: what a query reads; rows that wait; what diagnoses say, once for all that say it
    transaction.py   Transaction: what a change writes;  Group: the database transaction that changes share
    events.py        the log: batches, diagnoses and all other events, as they are read
    models.py, robots.py, observations.py, start_ups.py, diagnoses.py, repairs.py, journal.py, attempts.py,
    drills.py, moments.py, batch_jobs.py, agent_actions.py, api_keys.py, global_stop.py, audit.py,
    notifications.py
                     each subject: functions of a View that read it, of a Transaction that write it
    database.py      connections, and what differs between SQLite and PostgreSQL
    writer.py        the threads: one commits in groups, a few read
    ownership.py     one owner per robot, with fencing numbers; the instance's lock and its ear
    portable.py      export, import and backup;  pruning.py  retention, and how fast it grows
"""

from __future__ import annotations

from robomend.store.rows import View
from robomend.store.store import Store, opened
from robomend.store.transaction import Transaction

__all__ = ["Store", "Transaction", "View", "opened"]
