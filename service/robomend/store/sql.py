"""SqlStore: the threads and the event loop, put together.

event loop ── write ──► writer thread ── one transaction a group ──► database
           ── read ───► reader threads ── a snapshot each ─────────► database
           ◄─ events ── tail ◄── signs ── session thread ◄────────── database (other instances)
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

from robomend.errors import StoreError, StoreOverloaded
from robomend.store import portable, pruning
from robomend.store.database import Database
from robomend.store.encoding import checked
from robomend.store.interface import Transaction, View
from robomend.store.ownership import SqlOwnership
from robomend.store.reading import SqlView
from robomend.store.records import IdempotencyKey, Pruned, Retention, StoreFigures
from robomend.store.session import InstanceSession, PostgresSession, SqliteSession
from robomend.store.tail import Tail
from robomend.store.writer import Job, Writer
from robomend_client.events import Event

T = TypeVar("T")

READERS = 4
MAX_READS = 2000


class SqlStore:
    """robomend.store.interface.Store on SQLite or PostgreSQL."""

    def __init__(self, url: str) -> None:
        self._database = Database(url)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._writer = Writer(self._database, self._finished_in_thread)
        self._readers = ThreadPoolExecutor(READERS, thread_name_prefix="store-reader")
        self._reading = 0
        self._tail = Tail(self._read_events)
        self._session: InstanceSession
        if self._database.path is not None:
            self._session = SqliteSession(self._database.path, self._on_sign, self._on_lost)
        else:
            self._session = PostgresSession(self._database.url, self._on_sign, self._on_lost)
        self._ownership = SqlOwnership(self, self._session)
        self._closed = False

    @property
    def url(self) -> str:
        return self._database.shown

    @property
    def ownership(self) -> SqlOwnership:
        return self._ownership

    # --- life

    async def start(self) -> None:
        self._loop = asyncio.get_running_loop()
        await self._loop.run_in_executor(self._readers, self._database.prepare)
        self._tail.start((await self.read(lambda view: view.event_range())).newest)
        await self._loop.run_in_executor(self._readers, self._session.start)
        self._writer.start()
        self._ownership.start()

    async def close(self) -> None:
        if self._loop is None or self._closed:
            return
        self._closed = True
        with contextlib.suppress(StoreError):  # gone already: there is nobody to tell
            await self._ownership.close()
        await self._tail.close()
        loop = asyncio.get_running_loop()
        await loop.run_in_executor(None, self._writer.close)
        await loop.run_in_executor(None, self._session.close)
        self._readers.shutdown(wait=False, cancel_futures=True)
        self._database.dispose()

    # --- reading and writing

    async def read(self, query: Callable[[View], T]) -> T:
        if self._closed:
            raise StoreError("the store is closed")
        if self._reading >= MAX_READS:
            raise StoreOverloaded(f"{MAX_READS} reads are waiting; try again in a moment")
        self._reading += 1
        try:
            return await self._running().run_in_executor(self._readers, self._read_in_thread, query)
        finally:
            self._reading -= 1

    def _read_in_thread(self, query: Callable[[View], T]) -> T:
        with self._database.reading() as connection:
            return query(SqlView(connection))

    async def write(
        self,
        change: Callable[[Transaction], T],
        *,
        robots: Iterable[str] = (),
        once: IdempotencyKey | None = None,
    ) -> T:
        names = tuple(checked(robot) for robot in robots)
        if once is not None:  # a text that no column takes must not reach the group
            for part in (once.scope, once.key, once.request):
                checked(part)
        future: asyncio.Future[T] = self._running().create_future()
        self._writer.submit(Job(change, names, once, future, time.monotonic()))
        return await future

    def _finished_in_thread(self, jobs: Sequence[Job], events: tuple[Event, ...]) -> None:
        with contextlib.suppress(RuntimeError):  # the event loop has ended without closing us
            self._running().call_soon_threadsafe(self._finished, jobs, events)

    def _finished(self, jobs: Sequence[Job], events: tuple[Event, ...]) -> None:
        for job in jobs:
            if job.future.done():  # who waited was cancelled
                continue
            if job.error is None:
                job.future.set_result(job.result)
            else:
                job.future.set_exception(job.error)
        self._tail.committed(events)

    def _running(self) -> asyncio.AbstractEventLoop:
        if self._loop is None:
            raise StoreError("the store is not started")
        return self._loop

    # --- events

    def subscribe(self, callback: Callable[[tuple[Event, ...]], None]) -> Callable[[], None]:
        return self._tail.listen(callback)

    async def _read_events(self, after: int) -> tuple[Event, ...]:
        return await self.read(lambda view: view.events(after))

    def _on_sign(self, newest: int) -> None:
        self._from_thread(self._tail.sign, newest)

    def _on_lost(self) -> None:
        self._from_thread(self._ownership.lost)

    def _from_thread(self, call: Callable[..., None], *args: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the event loop has ended
            self._running().call_soon_threadsafe(call, *args)

    # --- upkeep

    async def prune(self, retention: Retention, *, slice: int = 1000) -> Pruned:
        return await pruning.prune(self, retention, slice)

    async def backup(self, path: Path) -> None:
        await self._running().run_in_executor(None, portable.backup, self._database, path)

    def export(self) -> Iterator[str]:
        self._database.prepare()
        return portable.export(self._database)

    def load(self, lines: Iterable[str]) -> int:
        self._database.prepare()
        return portable.load(self._database, lines)

    def figures(self) -> StoreFigures:
        queued, oldest_s = self._writer.waiting()
        return StoreFigures(
            queued_writes=queued,
            oldest_write_s=oldest_s,
            commits=self._writer.commits,
            writes=self._writer.writes,
            last_commit_s=self._writer.last_commit_s,
            newest_event=self._tail.last,
        )
