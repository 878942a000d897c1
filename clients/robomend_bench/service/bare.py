"""The least that a service can do with a change: take it over HTTP, put it on the disk, answer.

    POST ──► Starlette ──► JSON ──► queue ──► one thread, one transaction a group, one fsync ──► answer

It diagnoses nothing, checks nothing and tells nobody. What robomend takes of the processor beside it is what
diagnosis, checks, events and history cost. `python -m robomend_bench.service.bare FOLDER [DATABASE]` runs it.
"""

from __future__ import annotations

import asyncio
import json
import socket
import sqlite3
import sys
import threading
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse
from starlette.routing import Route

Row = tuple[str, str]
TABLE = "robomend_bench_bare"
MOST = 512
"""Changes in a group, as robomend's writer has it."""


class Log:
    """A table that a thread of its own appends to, in groups."""

    def __init__(self, append: Callable[[Sequence[Row]], None], loop: asyncio.AbstractEventLoop) -> None:
        self._append = append
        self._loop = loop
        self._waiting: deque[tuple[Row, asyncio.Future[int]]] = deque()
        self._wake = threading.Condition()
        self._count = 0
        threading.Thread(target=self._run, daemon=True).start()

    async def append(self, row: Row) -> int:
        """Return the number of the row, when it is on the disk."""
        future: asyncio.Future[int] = self._loop.create_future()
        with self._wake:
            self._waiting.append((row, future))
            self._wake.notify()
        return await future

    def _run(self) -> None:
        while True:
            with self._wake:
                while not self._waiting:
                    self._wake.wait()
                group = [self._waiting.popleft() for _ in range(min(len(self._waiting), MOST))]
            self._append([row for row, _ in group])
            self._loop.call_soon_threadsafe(self._written, [future for _, future in group])

    def _written(self, futures: list[asyncio.Future[int]]) -> None:
        for future in futures:
            self._count += 1
            if not future.done():
                future.set_result(self._count)


def into_sqlite(path: Path) -> Callable[[Sequence[Row]], None]:
    """Return what appends to a SQLite database that keeps what robomend's does."""
    database = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    for pragma in ("journal_mode=WAL", "synchronous=FULL"):
        database.execute(f"PRAGMA {pragma}")
    database.execute(f"CREATE TABLE {TABLE} (number INTEGER PRIMARY KEY, robot TEXT, data TEXT)")

    def append(rows: Sequence[Row]) -> None:
        database.execute("BEGIN IMMEDIATE")
        database.executemany(f"INSERT INTO {TABLE} (robot, data) VALUES (?, ?)", rows)
        database.execute("COMMIT")

    return append


def into_postgresql(url: str) -> Callable[[Sequence[Row]], None]:
    """Return what appends to a table of its own in a PostgreSQL database."""
    import psycopg

    connection = psycopg.connect(url)
    with connection.cursor() as cursor:
        cursor.execute(f"DROP TABLE IF EXISTS {TABLE}")
        cursor.execute(f"CREATE TABLE {TABLE} (number bigserial PRIMARY KEY, robot text, data text)")
    connection.commit()

    def append(rows: Sequence[Row]) -> None:
        with connection.cursor() as cursor:
            cursor.executemany(f"INSERT INTO {TABLE} (robot, data) VALUES (%s, %s)", rows)
        connection.commit()

    return append


def application(append: Callable[[Sequence[Row]], None]) -> Starlette:
    """Return the application; its log begins with the first request."""
    log: Log | None = None

    async def post(request: Request) -> JSONResponse:
        nonlocal log
        if log is None:
            log = Log(append, asyncio.get_running_loop())
        body: dict[str, Any] = await request.json()
        number = await log.append((request.path_params["robot"], json.dumps(body)))
        return JSONResponse({"revision": number, "changed": body["observations"]})

    return Starlette(routes=[Route("/api/v1/robots/{robot}/observations", post, methods=["POST"])])


def main(folder: str, database: str = "") -> None:
    """Serve on a free port of this computer, and say on which."""
    append = into_postgresql(database) if database else into_sqlite(Path(folder) / "bare.db")
    listening = socket.create_server(("127.0.0.1", 0))
    print(json.dumps({"url": f"http://127.0.0.1:{listening.getsockname()[1]}"}), flush=True)
    config = uvicorn.Config(
        application(append), log_config=None, access_log=False, lifespan="off", timeout_keep_alive=30
    )
    uvicorn.Server(config).run(sockets=[listening])  # on uvloop, if it is there, as robomend


if __name__ == "__main__":
    main(*sys.argv[1:])
