"""One thread that writes: whatever is queued goes into one transaction, with one fsync (group commit).

    await write ──► queue (bounded) ──► take all ──► one transaction ──► COMMIT ──► results and events
                                                                          to the event loop

Nobody waits for a group to fill: while one group is being committed the next one gathers. The busier the
store, the larger the groups and the cheaper each write.

What goes wrong ends with those whom it concerns:

- A change that raises: its own savepoint is rolled back; the others go on.
- A deadlock, a unique key that another instance was faster with, a connection found dead: the group is
  repeated.
- Rows that the database refuses at the end of the group: the group is repeated one by one, to find the
  culprit.
- No connection: everything queued fails at once, and the next write tries again.
- Lost during COMMIT: nobody knows; StoreError says so, and idempotency keys make a repeat safe.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any, Concatenate, ParamSpec, TypeVar

from sqlalchemy import Connection, exc

from robomend.errors import StoreError, StoreOverloaded
from robomend.store.database import Database, repeatable, translate
from robomend.store.encoding import checked
from robomend.store.records import IdempotencyKey
from robomend.store.rows import View
from robomend.store.transaction import Group, Transaction
from robomend_client.events import Event

MAX_QUEUED = 10_000
MAX_GROUP = 512
GROUP_TIME_S = 0.1
"""A group is committed after so long, however much is queued: the first in it waits for the last."""
ATTEMPTS = 4

READERS = 4
MAX_READS = 2000

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(slots=True, eq=False)
class Job:
    """A queued change and where its result goes."""

    change: Callable[[Transaction], Any]
    robots: tuple[str, ...]
    once: IdempotencyKey | None
    future: asyncio.Future[Any]
    queued_s: float
    result: Any = None
    error: BaseException | None = None


Finished = Callable[[Sequence[Job], tuple[Event, ...]], None]
"""Called in the writer's thread with jobs that have a result or an error, and the events of their commit."""


class Writer:
    """The thread and its queue."""

    def __init__(self, database: Database, finished: Finished) -> None:
        self._database = database
        self._finished = finished
        self._jobs: deque[Job] = deque()
        self._in_hand_s: float | None = None  # since when the oldest of the group under way waits
        self._bell: SimpleQueue[None] = SimpleQueue()  # rung for each change, and at the end
        self._open = threading.Lock()  # nothing is queued behind the end
        self._closing = False
        self._connection: Connection | None = None
        self._thread = threading.Thread(target=self._run, name="store-writer", daemon=True)
        self.committing = False
        """Whether a COMMIT is under way of which nobody was told."""
        self.commits = 0
        self.writes = 0
        self.last_commit_s = 0.0

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self, timeout_s: float = 30.0) -> None:
        """Write what is queued, then end the thread. Blocking."""
        with self._open:
            self._closing = True
        self._bell.put(None)
        if self._thread.is_alive():
            self._thread.join(timeout_s)

    def submit(self, job: Job) -> None:
        """Queue a change.

        Raises:
            StoreOverloaded: too many wait already.
            StoreError: the store is closed.
        """
        with self._open:
            if self._closing:
                raise StoreError("the store is closed")
            if len(self._jobs) >= MAX_QUEUED:
                raise StoreOverloaded(f"{MAX_QUEUED} writes are waiting for the disk; try again in a moment")
            self._jobs.append(job)
        self._bell.put(None)

    def waiting(self) -> tuple[int, float]:
        """Return how many changes are queued, and how long the oldest that is not on disk has waited, in
        seconds: one whose group hangs in the middle, too.
        """
        in_hand_s = self._in_hand_s
        return len(self._jobs), self.queued_s() if in_hand_s is None else time.monotonic() - in_hand_s

    def queued_s(self) -> float:
        """Return how long the oldest has waited whose group has not begun."""
        try:
            return time.monotonic() - self._jobs[0].queued_s
        except IndexError:
            return 0.0

    def _run(self) -> None:
        while jobs := self._take():
            self._write(jobs)
        self._drop_connection()

    def _take(self) -> list[Job]:
        self._in_hand_s = None
        while not self._jobs and not self._closing:
            self._bell.get()  # there may be more rings than changes left: a group takes all there are
        jobs = [self._jobs.popleft() for _ in range(min(len(self._jobs), MAX_GROUP))]
        self._in_hand_s = jobs[0].queued_s if jobs else None
        return jobs

    def _write(self, jobs: list[Job]) -> None:
        """Write a group, again where that may help, until each of its jobs has a result or an error."""
        for attempt in range(ATTEMPTS):
            try:
                left = self._transact(jobs)
            except _NoConnection as failure:
                self._fail([*jobs, *self._take_all()], failure.error)
                return
            except _Repeat as failure:
                if attempt + 1 == ATTEMPTS:
                    self._fail(jobs, failure.error)
                continue
            except exc.OperationalError as error:  # the database's fault, not a row's
                self._fail(jobs, translate(error))
                return
            except Exception as error:  # noqa: BLE001  # whatever a row held that no column takes
                if len(jobs) == 1:
                    self._fail(jobs, translate(error) if isinstance(error, exc.DBAPIError) else error)
                else:
                    for job in jobs:
                        self._write([job])
                return
            self._jobs.extendleft(reversed(left))
            return

    def _transact(self, jobs: list[Job]) -> list[Job]:
        """Run and commit a group; return those for which there was no time."""
        begun = time.monotonic()
        for job in jobs:
            job.error = None
        connection, committing = self._connect(), False
        try:
            connection.begin()
            group = Group(
                connection,
                {robot for job in jobs for robot in job.robots},
                [job.once for job in jobs if job.once is not None],
                time.time_ns(),
            )
            count = 0
            for job in jobs:
                self._run_job(group, job)
                count += 1
                if time.monotonic() - begun > GROUP_TIME_S:
                    break
            group.finish()
            self.committing = committing = True
            connection.commit()
        except BaseException as error:
            self.committing = False
            self._roll_back()
            if committing and isinstance(error, exc.DBAPIError) and error.connection_invalidated:
                raise _NoConnection(
                    StoreError(
                        "the connection was lost during a commit: it may be kept or not; repeat with its key"
                    )
                ) from error
            if repeatable(error):
                raise _Repeat(translate(error)) from error
            raise
        events = group.events()
        self.commits += 1
        self.writes += count
        self.last_commit_s = time.monotonic() - begun
        self.committing = False  # first: of a sign that comes after our events nobody else would tell
        self._finished(jobs[:count], events)
        return jobs[count:]

    def _run_job(self, group: Group, job: Job) -> None:
        try:
            job.result = group.run(job.change, job.once)
        except exc.OperationalError:
            raise  # the transaction is lost, and with it the group
        except Exception as error:  # the caller's own, handed back to it
            if group.connection.invalidated:
                raise
            job.error = translate(error) if isinstance(error, exc.DBAPIError) else error
            self._database.note(job.error)

    def _connect(self) -> Connection:
        if self._connection is None:
            try:
                self._connection = self._database.open_writer()
            except StoreError as error:
                raise _NoConnection(error) from error
        return self._connection

    def _roll_back(self) -> None:
        """Leave a connection that is in no transaction, or none."""
        if self._connection is None or self._connection.invalidated:
            self._drop_connection()
            return
        try:
            self._connection.rollback()
        except exc.SQLAlchemyError:
            self._drop_connection()

    def _drop_connection(self) -> None:
        if self._connection is not None:
            connection, self._connection = self._connection, None
            try:
                connection.close()
            except exc.SQLAlchemyError:
                connection.invalidate()

    def _take_all(self) -> list[Job]:
        return [self._jobs.popleft() for _ in range(len(self._jobs))]

    def _fail(self, jobs: Sequence[Job], error: BaseException) -> None:
        self._database.note(error)
        for job in jobs:
            job.error = error
        self._finished(jobs, ())


class _Repeat(Exception):
    """The group was rolled back and is worth another try."""

    def __init__(self, error: BaseException) -> None:
        super().__init__(error)
        self.error = error


class _NoConnection(_Repeat):
    """There is no database to try it on."""


class StoreThreads:
    """The threads of a store, as its event loop uses them: one writes, a few read, each in a snapshot."""

    def __init__(self, database: Database, committed: Callable[[tuple[Event, ...]], None]) -> None:
        """`committed` is called in the event loop with the events of each commit of ours, once it is over."""
        self._database = database
        self._committed = committed
        self._loop: asyncio.AbstractEventLoop | None = None
        self._writer = Writer(database, self._finished_in_thread)
        self._readers = ThreadPoolExecutor(READERS, thread_name_prefix="store-reader")
        self._reading = 0
        self._closed = False

    async def read(self, query: Callable[Concatenate[View, P], T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Return what `query(view, *args, **kwargs)` finds in one snapshot, in which everything is that was
        written before the call.
        """
        if self._closed:
            raise StoreError("the store is closed")
        if self._reading >= MAX_READS:
            raise StoreOverloaded(f"{MAX_READS} reads are waiting; try again in a moment")
        self._reading += 1
        try:
            return await self._running().run_in_executor(
                self._readers, self._read_in_thread, query, args, kwargs
            )
        finally:
            self._reading -= 1

    def _read_in_thread(self, query: Callable[..., T], args: tuple[Any, ...], kwargs: dict[str, Any]) -> T:
        with self._database.reading() as connection:
            return query(View(connection), *args, **kwargs)

    async def write(
        self,
        change: Callable[[Transaction], T],
        *,
        robots: Iterable[str] = (),
        once: IdempotencyKey | None = None,
    ) -> T:
        """Run `change` in a transaction and return its result when that is on disk.

        `robots` names the robots whose observations or repairs it writes: they are locked first, in one
        order, so that instances do not wait for each other in a circle.

        With `once`, the result must be a JSON value; a repeat returns the first result without running
        `change`, and StateConflict (code "idempotency-key-reused") if the request differs.

        Being cancelled does not take back a write that is queued.
        """
        names = tuple(robots)
        for robot in names:
            checked(robot)
        future: asyncio.Future[T] = self._running().create_future()
        self._writer.submit(Job(change, names, once, future, time.monotonic()))
        return await future

    async def wait_turn(self) -> None:
        """Return when it was our turn to write; nothing is written, and no disk is waited for on SQLite.

        Where another process keeps the lock of all writers, this takes as long as a write would.
        """
        await self.write(Transaction.wait_turn)

    def _finished_in_thread(self, jobs: Sequence[Job], events: tuple[Event, ...]) -> None:
        try:
            self._running().call_soon_threadsafe(self._finished, jobs, events)
        except RuntimeError:  # the event loop has ended without closing us
            return

    def _finished(self, jobs: Sequence[Job], events: tuple[Event, ...]) -> None:
        for job in jobs:
            if job.future.done():  # who waited was cancelled
                continue
            if job.error is None:
                job.future.set_result(job.result)
            else:
                job.future.set_exception(job.error)
        self._committed(events)

    def _running(self) -> asyncio.AbstractEventLoop:
        if self._loop is None:
            raise StoreError("the store is not started")
        return self._loop

    def oldest_queued_s(self) -> float:
        """Return how long the oldest write has waited whose group has not begun."""
        return self._writer.queued_s()
