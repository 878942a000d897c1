"""A real PostgreSQL server for tests: installed if it is missing, started once a session, gone afterwards.

Use it from a conftest.py: `from tests.postgres import postgres_server, postgres_url`. The server listens on a
Unix socket in a directory of its own, so no port is taken; every test gets a database of its own.
"""

from __future__ import annotations

import ctypes
import os
import pwd
import shutil
import signal
import subprocess
import tempfile
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psycopg
import pytest
from tests.packages import POSTGRESQL, postgresql

from robomend.store.database import Database

_PR_SET_PDEATHSIG = 1


@dataclass
class PostgresServer:
    """A server in a directory; `start`, `stop` and `crash` as a test likes."""

    directory: Path
    binaries: Path
    account: str  # PostgreSQL refuses to run as root
    process: subprocess.Popen[bytes] | None = field(default=None)

    def url(self, database: str = "postgres") -> str:
        """Return the URL of one of its databases."""
        return f"postgresql://{self.account}@/{database}?host={self.directory}"

    def create(self) -> None:
        """Lay the data directory."""
        os.chown(self.directory, pwd.getpwnam(self.account).pw_uid, -1)
        settings = ["--no-sync", "--auth=trust", "--encoding=UTF8", "--locale=C.UTF-8"]
        where = [f"--username={self.account}", "-D", str(self.directory / "data")]
        subprocess.run(
            [str(self.binaries / "initdb"), *settings, *where],
            check=True,
            capture_output=True,
            timeout=60,
            cwd="/",
            **self._as_account(),
        )

    def start(self) -> None:
        """Start it and wait until it answers, for at most 20 s.

        Call it in the main thread: the kernel ends the server with the thread that started it.
        """
        settings = {
            "listen_addresses": "",
            "unix_socket_directories": str(self.directory),
            "fsync": "off",  # a test kills processes, not the machine
            "max_connections": "60",
            "shared_buffers": "32MB",
        }
        log = (self.directory / "log").open("ab")
        options = [part for name, value in settings.items() for part in ("-c", f"{name}={value}")]
        with log:
            self.process = subprocess.Popen(
                [self.binaries / "postgres", "-D", self.directory / "data", *options],
                stdout=log,
                stderr=log,
                cwd="/",
                preexec_fn=_end_with_parent,  # no threads of ours hold locks here
                **self._as_account(),
            )
        deadline = time.monotonic() + 20
        while True:
            try:
                psycopg.connect(self.url(), connect_timeout=2).close()
                return
            except psycopg.OperationalError:
                if time.monotonic() > deadline:
                    raise AssertionError((self.directory / "log").read_text()) from None
                time.sleep(0.05)

    def stop(self, how: signal.Signals = signal.SIGINT) -> None:
        """End it: SIGINT ends connections and saves (fast), SIGQUIT is a crash."""
        if self.process is not None:
            self.process.send_signal(how)
            self.process.wait(20)
            self.process = None

    def crash(self) -> None:
        """End it as a crash would, without saving; it recovers from its log at the next start."""
        self.stop(signal.SIGQUIT)

    def _as_account(self) -> dict[str, Any]:
        if os.geteuid() != 0:
            return {}
        entry = pwd.getpwnam(self.account)
        return {"user": entry.pw_uid, "group": entry.pw_gid, "extra_groups": []}


def _end_with_parent() -> None:
    """Make the kernel stop the server when the test process is killed."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGINT)


def _binaries() -> Path:
    """Return where the server's programs are; install them if they are missing and we may."""
    why = POSTGRESQL.install()
    found = postgresql()
    assert found is not None, f"these tests need a PostgreSQL server: {why}"
    return found


def _account() -> str:
    """Return who runs the server: we, or as root somebody else."""
    if os.geteuid() != 0:
        return pwd.getpwuid(os.geteuid()).pw_name
    for name in ("postgres", "nobody"):
        try:
            return pwd.getpwnam(name).pw_name
        except KeyError:
            continue
    raise AssertionError("as root, these tests need an account named postgres or nobody to run the server")


@pytest.fixture(scope="session")
def postgres_server() -> Iterator[PostgresServer]:
    """The session's server, running."""
    directory = Path(tempfile.mkdtemp(prefix="robomend-postgres-"))
    server = PostgresServer(directory, _binaries(), _account())
    try:
        server.create()
        server.start()
        yield server
    finally:
        server.stop()
        shutil.rmtree(directory)


@pytest.fixture
def postgres_url(postgres_server: PostgresServer) -> Iterator[str]:
    """The URL of an empty database."""
    with empty_database(postgres_server) as url:
        yield url


@pytest.fixture(scope="session")
def postgres_laid(postgres_server: PostgresServer) -> str:
    """A database with the schema and nothing else, to be copied: laying it takes three times as long."""
    name = "laid"
    with psycopg.connect(postgres_server.url(), autocommit=True) as admin:
        admin.execute(f'CREATE DATABASE "{name}"')
    database = Database(postgres_server.url(name))
    database.prepare()
    database.dispose()
    return name


@contextmanager
def empty_database(postgres_server: PostgresServer, template: str = "template1") -> Iterator[str]:
    """Make a database that goes away; for what tests share."""
    name = f"test_{uuid.uuid4().hex}"
    with psycopg.connect(postgres_server.url(), autocommit=True) as admin:
        admin.execute(f'CREATE DATABASE "{name}" TEMPLATE "{template}"')
    yield postgres_server.url(name)
    with psycopg.connect(postgres_server.url(), autocommit=True) as admin:
        admin.execute(f'DROP DATABASE "{name}" WITH (FORCE)')
