"""Connections, and everything in which SQLite and PostgreSQL differ.

What "acknowledged" rests on:

- SQLite: write-ahead log with synchronous=FULL, so that COMMIT returns after the log is fsynced. (NORMAL,
  which is often recommended with WAL, fsyncs at checkpoints only: a power cut takes back the last commits.)
- PostgreSQL: synchronous_commit is switched on for our sessions if the server has it off; stronger settings
  (remote_write, remote_apply) are left as they are.
"""

from __future__ import annotations

import os
import sqlite3
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeGuard

from sqlalchemy import URL, Connection, Engine, create_engine, event, exc, make_url, select, text
from sqlalchemy.pool import ConnectionPoolEntry

from robomend.errors import (
    InputError,
    OptionRefused,
    RobomendError,
    StateConflict,
    StoreDamaged,
    StoreError,
    StoreFull,
)
from robomend.store import schema

BUSY_TIMEOUT_S = 10.0
"""How long a SQLite writer waits for a writer in another process."""

HANGS_MS = 4000
"""PostgreSQL: a writer that hangs in the middle of a transaction keeps its locks for so long."""

MIGRATION_S = 3600.0
"""PostgreSQL: a statement of a migration may take so long."""

FULL_S = 10.0
"""A write that was refused for want of room tells of the disk for so long: a smaller one may still fit."""

LOG_PAGES = 4000
"""SQLite: the write-ahead log is moved into the file when it has so many, 16 MB."""

WRITER_CACHE_KIB = 16_000
"""SQLite: pages that the writer keeps; with a thousand robots each change touches another one."""

TURN_S = 0.001
"""How often it looks whether it is its turn."""

LOOKS = "robomend_looks"
"""Of a SQLite connection: it does so, as long as it is a writer's."""

_POSTGRES_OPTIONS = {
    # Every wait has an end: for a server, for a row, for an answer, for a peer that fell silent.
    "connect_timeout": "3",
    "tcp_user_timeout": "8000",
    "keepalives_idle": "5",
    "keepalives_interval": "2",
    "keepalives_count": "2",
    "application_name": "robomend",
    # What a server without a locale (initdb in C) offers is bytes: text is text all the same.
    "client_encoding": "utf8",
}
_POSTGRES_SETTINGS = (
    "-c lock_timeout=5s -c statement_timeout=30s -c idle_in_transaction_session_timeout=60s"
    " -c client_min_messages=warning"
)
_DISK_FULL = "53100"
_RETRY = frozenset({"40001", "40P01"})  # serialization failure, deadlock
_DAMAGED = frozenset({sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB})
_SCHEMA_LOCK = 0x726F626F6D656E64  # "robomend": who creates or migrates


class Database:
    """One database: an engine to read, an engine to write, and a schema that is brought up to date."""

    def __init__(self, url: str) -> None:
        try:
            parsed = make_url(url)
        except exc.ArgumentError as error:
            raise OptionRefused(f"{url!r} is no database URL; try sqlite:///robomend.db") from error
        kind = parsed.get_backend_name()
        if kind == "sqlite" and parsed.database and parsed.database != ":memory:":
            self.path: Path | None = Path(parsed.database)
            self.url = parsed
        elif kind == "postgresql":
            if find_spec("psycopg") is None:
                raise OptionRefused("PostgreSQL needs its driver: pip install 'robomend[postgres]'")
            self.path = None
            self.url = _postgres_url(parsed)
        else:
            raise OptionRefused(
                f"no store for {parsed.render_as_string()!r}:"
                " it is sqlite:///path/to/file.db or postgresql://…"
            )
        self.kind = kind
        self.shown = parsed.render_as_string(hide_password=True)
        self._engine = _sqlite_engine(self.url) if self.path else _postgres_engine(self.url)
        self.damage: str | None = None
        """What is wrong with the file, once something was found: it is not tried again."""
        self._refused = ("", -FULL_S)
        self._reading = self._engine
        if self.path is None:
            self._reading = self._engine.execution_options(
                isolation_level="REPEATABLE READ", postgresql_readonly=True
            )

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """A read-only snapshot."""
        try:
            with translated(), self._reading.connect() as connection, connection.begin():
                yield connection
        except StoreDamaged as error:
            self.note(error)
            raise

    def open_writer(self) -> Connection:
        """Return a connection whose transactions may write; on SQLite they lock out other writers at once."""
        with translated():
            connection = self._engine.connect().execution_options(robomend_writes=True)
            if self.path is not None:
                connection.exec_driver_sql(f"PRAGMA cache_size=-{WRITER_CACHE_KIB}")
                connection.rollback()
            else:
                connection.exec_driver_sql(f"SET idle_in_transaction_session_timeout = {HANGS_MS}")
                connection.commit()
            return connection

    def prepare(self) -> None:
        """Create or migrate the schema; quick when it is current.

        Raises:
            StoreDamaged: a part of the file is missing.
            StoreError: the database cannot be reached, or a newer robomend has written it.
        """
        if self.path is not None:
            _make_private(self.path)
        with translated(), self._engine.connect() as connection, _patiently(connection):
            if self.path is not None:
                _check_whole(connection, self.path)
            if _version(connection) == schema.HEAD:
                return
            connection.rollback()
            connection = connection.execution_options(robomend_writes=True)
            with connection.begin():
                if self.path is None:  # on SQLite the transaction itself locks others out
                    # A migration may take its time, and so may the instance that is before us.
                    connection.execute(text(f"SET LOCAL statement_timeout = '{MIGRATION_S:.0f}s'"))
                    connection.execute(text("SET LOCAL lock_timeout = '10min'"))
                    connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _SCHEMA_LOCK})
                found = _version(connection)
                if found is None:
                    schema.metadata.create_all(connection, checkfirst=False)
                    connection.execute(schema.version.insert().values(version_num=schema.HEAD))
                    names = ({"name": name, "value": 0} for name in ("event", "audit"))
                    connection.execute(schema.counters.insert(), list(names))
                elif found != schema.HEAD:
                    _migrate(connection, found)

    def note(self, error: BaseException) -> None:
        """Remember it, if the error says that the file is damaged, or the disk full."""
        if isinstance(error, StoreDamaged):
            self.damage = str(error)
        elif isinstance(error, StoreFull):
            self._refused = (str(error), time.monotonic())

    @property
    def full(self) -> str | None:
        """Why a write was refused for want of room, not long ago."""
        why, at_s = self._refused
        return why if time.monotonic() - at_s < FULL_S else None

    def dispose(self) -> None:
        """Close the connections that nobody uses."""
        self._engine.dispose()


def _patiently(connection: Connection) -> AbstractContextManager[Any]:
    """Return a context in which an answer of PostgreSQL's may take as long as a migration."""
    itself: Any = connection.connection.driver_connection
    return nullcontext() if connection.dialect.name == "sqlite" else itself.patient(MIGRATION_S)


def _version(connection: Connection) -> str | None:
    """Return the version that the database has, None for an empty one."""
    if connection.dialect.name == "sqlite":
        exists = "SELECT 1 FROM sqlite_master WHERE name = 'alembic_version'"
    else:
        exists = "SELECT 1 WHERE to_regclass('alembic_version') IS NOT NULL"
    if connection.execute(text(exists)).first() is None:
        return None
    return connection.execute(select(schema.version.c.version_num)).scalar()


def _migrate(connection: Connection, found: str) -> None:
    from robomend.store.migrations import upgrade  # Alembic takes seconds to load, and is seldom needed

    upgrade(connection, found)


def _make_private(path: Path) -> None:
    """Create the directory and an empty database that only its owner can read: it holds hashes of keys."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        os.close(os.open(path, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600))
    except OSError as error:
        raise StoreError(f"{path}: {error.strerror}; name a database file that can be written") from error


def _check_whole(connection: Connection, path: Path) -> None:
    """Refuse a file that is shorter than SQLite says it is: reads of what is missing would fail one by one.

    Other damage is only found where it is read. What the write-ahead log has is brought into the file first;
    where somebody reads the log meanwhile, nothing can be told.
    """
    raw = connection.connection.driver_connection  # outside of a transaction, which would hold the log back
    assert isinstance(raw, sqlite3.Connection)
    pages, bytes_a_page, (_, in_log, moved) = (
        raw.execute(f"PRAGMA {name}").fetchone() for name in ("page_count", "page_size", "wal_checkpoint")
    )
    wanted, there = pages[0] * bytes_a_page[0], path.stat().st_size
    if in_log == moved and there < wanted:
        raise _damaged(f"{path} has {there} bytes of {wanted}")


def _damaged(said: str) -> StoreDamaged:
    return StoreDamaged(
        f"the database is damaged ({said}): end the service, keep the file, and put a copy in its place,"
        " as docs/storage.md says"
    )


def _is_damage(cause: BaseException | None) -> bool:
    return getattr(cause, "sqlite_errorcode", 0) & 0xFF in _DAMAGED


def _sqlite_engine(url: URL) -> Engine:
    # Python's own transactions are off (isolation_level None): BEGIN is ours, so that a writer starts
    # IMMEDIATE and waits its turn, where a reader that turns into a writer would fail at once.
    connect_args = {"isolation_level": None, "check_same_thread": False, "timeout": BUSY_TIMEOUT_S}
    engine = create_engine(url, connect_args=connect_args, pool_size=6, max_overflow=10)

    @event.listens_for(engine, "connect")
    def _configure(connection: sqlite3.Connection, _entry: ConnectionPoolEntry) -> None:
        for pragma in (
            "journal_mode=WAL",
            "synchronous=FULL",
            "cache_size=-4000",  # KiB a connection
            # A page of the log that robots' rows share is then moved into the file once for some of them.
            f"wal_autocheckpoint={LOG_PAGES}",
            "journal_size_limit=67108864",
            "temp_store=MEMORY",
        ):
            connection.execute(f"PRAGMA {pragma}")

    @event.listens_for(engine, "checkin")
    def _give_back(connection: sqlite3.Connection | None, entry: ConnectionPoolEntry) -> None:
        if entry.info.pop(LOOKS, False) and connection is not None:
            connection.execute(f"PRAGMA busy_timeout={BUSY_TIMEOUT_S * 1000:.0f}")

    @event.listens_for(engine, "begin")
    def _begin(connection: Connection) -> None:
        options = connection.get_execution_options()
        if options.get("robomend_writes"):
            _begin_writing(connection)
        else:
            connection.exec_driver_sql("BEGIN")

    return engine


def _begin_writing(connection: Connection) -> None:
    """BEGIN IMMEDIATE, once it is our turn among the processes that write.

    SQLite's own wait sleeps up to 0.1 s at a time, and whoever writes often gets in between: a process that
    writes now and then waited for up to a second, and a stop with it. Looking each millisecond: 7 ms.
    """
    raw: Any = connection.connection.driver_connection
    if not connection.info.get(LOOKS):
        raw.execute("PRAGMA busy_timeout=0")
        connection.info[LOOKS] = True
    end = time.monotonic() + BUSY_TIMEOUT_S
    while time.monotonic() < end:
        try:
            raw.execute("BEGIN IMMEDIATE")
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode & 0xFF != sqlite3.SQLITE_BUSY:
                break
            time.sleep(TURN_S)
        else:
            return
    connection.exec_driver_sql("BEGIN IMMEDIATE")  # it fails, and in the library's words


def _postgres_url(url: URL) -> URL:
    options = dict(_POSTGRES_OPTIONS)
    given = {name: str(value) for name, value in url.query.items() if isinstance(value, str)}
    settings = f"{_POSTGRES_SETTINGS} {given.pop('options', '')}".strip()
    return url.set(drivername="postgresql+psycopg", query=options | given | {"options": settings})


def _postgres_engine(url: URL) -> Engine:
    from robomend.store.bounded import BoundedConnection

    engine = create_engine(url, pool_size=6, max_overflow=10, pool_pre_ping=True, use_native_hstore=False)

    @event.listens_for(engine, "do_connect")
    def _connect(_dialect: Any, _record: Any, arguments: Any, options: Any) -> Any:
        return BoundedConnection.connect(*arguments, **options)

    @event.listens_for(engine, "connect")
    def _configure(connection: Any, _entry: ConnectionPoolEntry) -> None:
        with connection.cursor() as cursor:
            cursor.execute(
                "SELECT set_config('synchronous_commit', 'on', false)"
                " WHERE current_setting('synchronous_commit') = 'off'"
            )
        connection.commit()

    return engine


@contextmanager
def translated() -> Iterator[None]:
    """Turn the database library's errors into ours. The messages leave out statements and their values."""
    try:
        yield
    except exc.DBAPIError as error:
        raise translate(error) from error
    except exc.TimeoutError as error:
        raise StoreError("no database connection became free in time; try again") from error


def translate(error: exc.DBAPIError) -> RobomendError:
    """Return the error of ours that says the same."""
    cause = error.orig
    said = str(cause).strip().splitlines()[0] if str(cause).strip() else type(cause).__name__
    if _is_full(cause):
        return StoreFull(f"the database's disk is full ({said}); make room: reading goes on meanwhile")
    if _is_damage(cause):
        return _damaged(said)
    if isinstance(error, exc.IntegrityError):
        return StateConflict(f"somebody else wrote the same at the same moment; try again ({said})")
    if isinstance(error, exc.DataError):
        return InputError(f"the database cannot hold this value: {said}")
    code = getattr(cause, "sqlite_errorcode", None)
    if code is not None and code & 0xFF in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        return StoreError(f"another process kept the database locked for {BUSY_TIMEOUT_S:g} s; try again")
    return StoreError(f"the database does not answer as it should: {said}")


def repeatable(error: BaseException) -> TypeGuard[exc.DBAPIError]:
    """Return whether a transaction that ended in this error, before its COMMIT, is worth another try."""
    if not isinstance(error, exc.DBAPIError):
        return False
    if error.connection_invalidated or isinstance(error, exc.IntegrityError):
        return True
    return getattr(error.orig, "sqlstate", None) in _RETRY


def _is_full(cause: BaseException | None) -> bool:
    if getattr(cause, "sqlite_errorcode", 0) & 0xFF == sqlite3.SQLITE_FULL:
        return True
    return getattr(cause, "sqlstate", None) == _DISK_FULL
