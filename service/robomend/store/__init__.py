"""Durable memory: everything that must survive a power cut, in SQLite or PostgreSQL.

`open_store(url)` gives a Store; interface.py says what it can do and records.py what it keeps.

    interface.py     the contract: Transaction (writes), Store, Ownership;  view.py  View (reads)
    records.py       the frozen values;  encoding.py  as columns
    schema.py        the tables;  migrations/  how older databases get there
    database.py      connections, and what differs between SQLite and PostgreSQL
    snapshot.py      questions and pages;  reading.py, repair_reading.py  View
    transaction.py   what a group of changes shares;  writing.py, repair_writing.py  Transaction
    writer.py        one thread that commits in groups
    tail.py          the event log as it grows, in this and other processes
    session.py       the instance's lock and its ear;  ownership.py  one owner per robot, with fencing numbers
    portable.py      export, import and backup;  pruning.py  retention
    sql.py           SqlStore: all of it together
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robomend.store.interface import Store

__all__ = ["database_in", "open_store"]


def database_in(folder: Path) -> str:
    """Return the URL of the SQLite database in a data folder."""
    return f"sqlite:///{folder.expanduser().resolve() / 'robomend.db'}"


def open_store(url: str) -> Store:
    """Return the store at `sqlite:///relative.db`, `sqlite:////absolute.db` or `postgresql://user@host/name`.

    Nothing is opened before `start`.

    Raises:
        OptionRefused: another kind of database.
    """
    from robomend.store.sql import SqlStore  # the database library is loaded by those who use it

    return SqlStore(url)
