"""The event log as it grows: every event, once, in order of id, whichever instance wrote it.

Ids have no gaps and are committed in their order (group.py), so order is easy to keep: an own commit
that follows on the last event delivered is delivered as it is; anything else is a sign that another instance
has written, and the log is read from the last one delivered. Signs come from the own commits and from the
session (session.py), which hears of other instances' commits. A sign that is lost costs nothing but time, as
the next one has the same effect.

Everything here belongs to the event loop.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection

from robomend.errors import RobomendError
from robomend_client.events import Event, Kind

Read = Callable[[int], Awaitable[tuple[Event, ...]]]
"""Return some of the events after an id, oldest first; () when there are none."""

RETRY_S = 0.5


class Tail:
    """Hands new events to those who listen."""

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
