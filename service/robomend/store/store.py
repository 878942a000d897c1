"""The store: the threads and the event loop, put together.

    robot = await store.read(robots.get, "r1")

    def accept(tx: Transaction) -> int:
        return observations.observe(tx, "r1", accepted=entries, changed=entries)

    once = IdempotencyKey("bob POST /robots/r1/observations", key, digest)
    revision = await store.write(accept, robots=("r1",), once=once)

What one function writes is kept together or not at all, its events and audit entries included; when `write`
returns, it is on disk. What different functions write is committed in groups, in the order of the calls; one
that raises takes back its own writes and nobody else's.

Rules for the functions: they run in the store's threads, so they touch neither the event loop nor state that
others change; a write function may be run again when its group has to be repeated, so its only effect is on
`tx`; both are quick, for others wait.

    event loop ── write ──► writer thread ── one transaction a group ──► database
               ── read ───► reader threads ── a snapshot each ─────────► database
               ◄─ events ── tail ◄── signs ── session thread ◄────────── database (other instances)
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable, Collection
from typing import Any, ParamSpec, TypeVar

from robomend.errors import RobomendError, StoreError
from robomend.store import events as log
from robomend.store.database import Database
from robomend.store.ownership import InstanceSession, Ownership, PostgresSession, SqliteSession
from robomend.store.records import StoreFigures
from robomend.store.writer import StoreThreads
from robomend_client.events import Event, Kind

P = ParamSpec("P")
T = TypeVar("T")

Read = Callable[[int], Awaitable[tuple[Event, ...]]]
"""Return some of the events after an id, oldest first; () when there are none."""

RETRY_S = 0.5
"""While the database is away."""


class Tail:
    """The event log as it grows: every event, once, in order of id, whichever instance wrote it.

    Ids have no gaps and are committed in their order (transaction.py), so order is easy: an own commit that
    follows on the last event delivered is delivered as it is; anything else is a sign that another
    instance has written, and the log is read from the last one delivered. Signs come from the own commits and
    from the session (ownership.py), which hears of other instances' commits. A sign that is lost costs only
    time, as the next one has the same effect. Belongs to the event loop.
    """

    def __init__(self, read: Read, committing: Callable[[], bool] = lambda: False) -> None:
        """`committing`: whether a commit of our own is under way, which is told here in any case."""
        self._read = read
        self._committing = committing
        self._last = 0
        self._newest = 0  # the largest id that is known to exist
        self._listeners: list[tuple[Callable[[tuple[Event, ...]], None], frozenset[Kind] | None]] = []
        self._catching_up: asyncio.Task[None] | None = None
        self._closed = False

    @property
    def last(self) -> int:
        """The id of the last event delivered."""
        return self._last

    def start(self, newest: int) -> None:
        """Begin after the events that are there."""
        self._last = self._newest = newest

    async def close(self) -> None:
        """Stop reading."""
        self._closed = True
        if self._catching_up is not None:
            self._catching_up.cancel()
            await asyncio.wait({self._catching_up})

    def committed(self, events: tuple[Event, ...]) -> None:
        """Take the events of an own commit, if it had any and came off."""
        if events and events[0].id == self._last + 1:
            self._deliver(events)
        self._look(events[-1].id if events else 0)

    def sign(self, newest: int) -> None:
        """Hear that events up to this id exist: maybe those of a commit of ours, which come by themselves."""
        if self._committing():
            self._newest = max(self._newest, newest)
        else:
            self._look(newest)

    def _look(self, newest: int) -> None:
        self._newest = max(self._newest, newest)
        if self._newest > self._last and self._catching_up is None and not self._closed:
            self._catching_up = asyncio.get_running_loop().create_task(self._catch_up())

    async def _catch_up(self) -> None:
        try:
            while self._newest > self._last and not self._closed:
                try:
                    events = await self._read(self._last)
                except RobomendError:  # the database is away; what we miss stays there
                    await asyncio.sleep(RETRY_S)
                    continue
                # While we read, own commits may have been delivered.
                self._deliver(tuple(event for event in events if event.id > self._last))
                if not events:  # removed by retention before we came to them
                    self._last = max(self._last, self._newest)
        finally:
            self._catching_up = None

    def _deliver(self, events: tuple[Event, ...]) -> None:
        if not events:
            return
        self._last = events[-1].id
        there = {event.kind for event in events}
        for listener, kinds in tuple(self._listeners):
            if kinds is not None and kinds.isdisjoint(there):
                continue
            try:
                listener(events)
            except Exception as error:  # noqa: BLE001  # one listener's bug takes no event from the others
                told = {"message": "a listener to the store's events failed", "exception": error}
                asyncio.get_running_loop().call_exception_handler(told)

    def listen(
        self, callback: Callable[[tuple[Event, ...]], None], kinds: Collection[Kind] | None = None
    ) -> Callable[[], None]:
        """Call back with new events until the returned function is called.

        Args:
            kinds: of events without any of which the callback need not hear of a commit; None: all.
        """
        listener = (callback, None if kinds is None else frozenset(kinds))
        self._listeners.append(listener)

        def end() -> None:
            if listener in self._listeners:
                self._listeners.remove(listener)

        return end


class Store(StoreThreads):
    """Durable memory. `start` and `close` belong to one event loop; `read` and `write` come from it, too.

    Errors of every method: StoreError (the database is gone or refuses; it is tried again by the next call),
    StoreFull (writes only), StoreOverloaded (too much is queued).
    """

    def __init__(self, url: str) -> None:
        """Nothing is opened before `start`.

        Args:
            url: `sqlite:///relative.db`, `sqlite:////absolute.db` or `postgresql://user@host/name`.

        Raises:
            OptionRefused: another kind of database.
        """
        self._tail = Tail(self._read_events, lambda: self._writer.committing)
        super().__init__(Database(url), self._tail.committed)
        self._session: InstanceSession
        if self._database.path is not None:
            self._session = SqliteSession(self._database.path, self._on_sign, self._on_lost)
        else:
            self._session = PostgresSession(self._database.url, self._on_sign, self._on_lost)
        self._ownership = Ownership(self, self._session)

    @property
    def url(self) -> str:
        """Where it is, without a password."""
        return self._database.shown

    @property
    def damage(self) -> str | None:
        """What is wrong with the database file, once something was found."""
        return self._database.damage

    @property
    def full(self) -> str | None:
        """Why a write was refused for want of room, not long ago."""
        return self._database.full

    @property
    def ownership(self) -> Ownership:
        """Who owns which robot."""
        return self._ownership

    # --- life

    async def start(self) -> None:
        """Open the database, create or migrate its schema, start the threads."""
        self._loop = asyncio.get_running_loop()
        await self._loop.run_in_executor(self._readers, self._database.prepare)
        self._tail.start((await self.read(log.kept)).newest)
        self._ownership.begin_turning()
        await self._loop.run_in_executor(self._readers, self._session.start)
        self._writer.start()
        self._ownership.start()

    async def close(self) -> None:
        """Finish what is queued, release all robots and end the threads."""
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

    # --- events

    def subscribe(
        self, callback: Callable[[tuple[Event, ...]], None], kinds: Collection[Kind] | None = None
    ) -> Callable[[], None]:
        """Call back, in the event loop, with every event committed
        from now on by any instance, in order of id.

        None is left out and none comes twice, also when the database was away. Returns a function that ends
        it. With `kinds`, commits without an event of these may be left out.
        """
        return self._tail.listen(callback, kinds)

    async def _read_events(self, after: int) -> tuple[Event, ...]:
        return await self.read(log.after, after)

    def _on_sign(self, newest: int) -> None:
        if newest > self._tail.last:  # else it was our own commit, and the event loop may sleep on
            self._from_thread(self._tail.sign, newest)

    def _on_lost(self) -> None:
        self._from_thread(self._ownership.lost)

    def _from_thread(self, call: Callable[..., None], *args: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the event loop has ended
            self._running().call_soon_threadsafe(call, *args)

    def figures(self) -> StoreFigures:
        """Return how busy it is."""
        queued, oldest_s = self._writer.waiting()
        return StoreFigures(
            queued_writes=queued,
            oldest_write_s=oldest_s,
            commits=self._writer.commits,
            writes=self._writer.writes,
            last_commit_s=self._writer.last_commit_s,
        )


@contextlib.asynccontextmanager
async def opened(url: str) -> AsyncIterator[Store]:
    """Open the database for as long as a command needs it."""
    store = Store(url)
    await store.start()
    try:
        yield store
    finally:
        await store.close()
