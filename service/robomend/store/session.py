"""The instance's standing link to its database: it shows that we live, and hears when others have written.

    PostgreSQL   one connection that holds an advisory lock of ours and LISTENs; the server frees the lock
                 when the connection ends, however it ends
    SQLite       a lock file beside the database (flock, freed by the kernel when the process ends), and a
                 look at SQLite's data_version every 50 ms

Who wants to know whether another instance lives tries its lock. A new name is drawn whenever the lock was
lost, so that nothing written under the old name counts as ours again.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import secrets
import sqlite3
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sqlalchemy import URL, Connection, text

from robomend.errors import StoreError
from robomend.store.transaction import CHANNEL

POLL_S = 0.05
"""SQLite: how late an event of another process may come."""
PING_S = 0.3
"""PostgreSQL: how often the connection is looked at, when nothing comes."""
BACK_OFF_S = (0.1, 0.2, 0.5, 1.0, 2.0)
READY_S = 5.0

# An end that falls silent is noticed within 4 s on both sides.
_CLIENT = {"tcp_user_timeout": "4000", "keepalives_idle": "1", "keepalives_interval": "1"}
_SERVER = (
    "-c tcp_keepalives_idle=1 -c tcp_keepalives_interval=1 -c tcp_keepalives_count=2"
    " -c tcp_user_timeout=4000 -c idle_session_timeout=0"
)


class InstanceSession(ABC):
    """A thread that keeps the link and takes it up again when it breaks.

    `on_sign(newest event id)` and `on_lost()` are called in that thread.
    """

    def __init__(self, on_sign: Callable[[int], None], on_lost: Callable[[], None]) -> None:
        self._on_sign = on_sign
        self._on_lost = on_lost
        self._instance: str | None = None
        self._ready = threading.Event()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="store-session", daemon=True)

    @property
    def instance(self) -> str | None:
        """Our name; None while we hold no lock."""
        return self._instance

    def start(self) -> None:
        """Start, and wait until the lock is held. Blocking.

        Raises:
            StoreError: it was not within 5 s.
        """
        self._thread.start()
        if not self._ready.wait(READY_S):
            self.close()
            raise StoreError("no lock could be taken beside the database within 5 s")

    def close(self) -> None:
        """Free the lock and end the thread. Blocking, well under a second."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join(READY_S)

    @abstractmethod
    def lives(self, instance: str, connection: Connection) -> bool:
        """Return whether another instance holds its lock; `connection` is in a transaction."""

    @abstractmethod
    def _hold(self) -> None:
        """Take the lock, say so with `_taken`, and serve until closing; raise when the link breaks."""

    def _taken(self, instance: str) -> None:
        self._instance = instance
        self._ready.set()

    def _run(self) -> None:
        failures = 0
        while not self._closing.is_set():
            with contextlib.suppress(Exception):  # whatever broke the link, it is taken up again
                self._hold()
            if self._instance is not None:
                failures = 0
                self._instance = None
                if not self._closing.is_set():
                    self._on_lost()
            self._closing.wait(BACK_OFF_S[min(failures, len(BACK_OFF_S) - 1)])
            failures += 1


class PostgresSession(InstanceSession):
    """An advisory lock and LISTEN on one connection."""

    def __init__(self, url: URL, on_sign: Callable[[int], None], on_lost: Callable[[], None]) -> None:
        super().__init__(on_sign, on_lost)
        _, arguments = url.get_dialect()().create_connect_args(url)
        self._arguments: dict[str, Any] = {**arguments, **_CLIENT}
        self._arguments["options"] = f"{self._arguments.get('options', '')} {_SERVER}"

    def lives(self, instance: str, connection: Connection) -> bool:
        # Shared, so that several who ask at once do not take each other for the instance.
        asked = text("SELECT pg_try_advisory_xact_lock_shared(:key)")
        return not connection.execute(asked, {"key": _lock_key(instance)}).scalar_one()

    def _hold(self) -> None:
        import psycopg

        with psycopg.connect(**self._arguments, autocommit=True) as connection:
            instance = secrets.token_hex(8)
            connection.execute("SELECT pg_advisory_lock(%s)", (_lock_key(instance),))
            connection.execute(f"LISTEN {CHANNEL}")
            row = connection.execute("SELECT value FROM counters WHERE name = 'event'").fetchone()
            self._taken(instance)
            self._on_sign(row[0] if row else 0)
            while not self._closing.is_set():
                for notification in connection.notifies(timeout=PING_S):
                    self._on_sign(int(notification.payload))
                    if self._closing.is_set():
                        return
                connection.execute("SELECT 1")


class SqliteSession(InstanceSession):
    """A locked file, and a look at the database now and then."""

    def __init__(self, path: Path, on_sign: Callable[[int], None], on_lost: Callable[[], None]) -> None:
        super().__init__(on_sign, on_lost)
        self._path = path
        self._locks = path.with_name(path.name + ".instances")

    def lives(self, instance: str, connection: Connection) -> bool:
        return not _free(self._locks / f"{instance}.lock")

    def _hold(self) -> None:
        self._locks.mkdir(mode=0o700, exist_ok=True)
        for old in self._locks.glob("*.lock"):
            _free(old)
        instance = secrets.token_hex(8)
        path = self._locks / f"{instance}.lock"
        # Not inheritable (Python's default): no worker process keeps the lock alive for a dead service.
        lock = os.open(path, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._watch(instance)
        finally:
            path.unlink(missing_ok=True)
            os.close(lock)

    def _watch(self, instance: str) -> None:
        connection = sqlite3.connect(self._path, isolation_level=None, timeout=1.0)
        try:
            seen = None
            self._taken(instance)
            while not self._closing.is_set():
                # data_version changes with every commit of another connection; it costs no disk access.
                version = connection.execute("PRAGMA data_version").fetchone()
                if version != seen:
                    row = connection.execute("SELECT value FROM counters WHERE name = 'event'").fetchone()
                    seen = version
                    self._on_sign(row[0] if row else 0)
                self._closing.wait(POLL_S)
        finally:
            connection.close()


def _lock_key(instance: str) -> int:
    return int.from_bytes(bytes.fromhex(instance), signed=True)


def _free(path: Path) -> bool:
    """Return whether nobody holds this lock file, and remove it then."""
    try:
        lock = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    except FileNotFoundError:
        return True
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        path.unlink(missing_ok=True)
        return True
    except BlockingIOError:
        return False
    finally:
        os.close(lock)
