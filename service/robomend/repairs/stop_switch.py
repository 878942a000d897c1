"""The global stop: in force here at once, on disk as soon as that is possible.

    any thread ── ask ──► in memory: nothing is sent from here on ──► the store ──► the other instances
                              │                                          │ full, away, slow
                              └──► the answer says whether it is written └──► again, until it is

A stop never waits for a disk. Lifting one does: until that is written, nothing moves. What is asked is
written in the order of the asking, each with its name, so that the audit log tells it all.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import structlog

from robomend.errors import RobomendError, StoreError
from robomend.store import Store, Transaction, global_stop
from robomend.store.records import AuditEntry, Stop
from robomend_client.events import Kind

log = structlog.get_logger("robomend.repairs.stop_switch")

AGAIN_S = 0.5
"""Between two tries to write."""

MOST = 1000
"""Changes that wait for a disk. A further stop then counts as the one that waits."""

LATE_S = 1.0
"""A change that was written later than this says in the audit log when it was asked for."""


@dataclass(eq=False)
class StopChange:
    """What somebody asked for."""

    active: bool
    by: str
    reason: str
    asked_ns: int
    written: concurrent.futures.Future[Stop] = field(default_factory=concurrent.futures.Future)
    """Done when it is on disk. Nobody cancels it."""


class StopSwitch:
    """See the module. `ask` and `stop` are for any thread, the rest for the event loop of the store."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._stop = Stop()
        self._lock = threading.Lock()
        self._unwritten: deque[StopChange] = deque()
        self._changes = 0  # so that what was read before a change does not undo it
        self._callbacks: list[Callable[[], None]] = []
        self._loop: asyncio.AbstractEventLoop | None = None
        self._writing: asyncio.Task[None] | None = None
        self.failure = ""
        """Why the oldest unwritten change is not on disk yet."""

    @property
    def stop(self) -> Stop:
        """The stop as this instance acts on it."""
        return self._stop

    @property
    def active(self) -> bool:
        """Whether nothing may be sent now."""
        return self._stop.active

    def on_change(self, callback: Callable[[], None]) -> None:
        """Call back, in the event loop, after each change."""
        self._callbacks.append(callback)

    async def start(self) -> None:
        """Read the stop from the store; its changes are followed from now on."""
        self._loop = asyncio.get_running_loop()
        self._stop = await self._store.read(global_stop.get)

    async def close(self) -> None:
        """End trying to write."""
        if self._writing is not None:
            self._writing.cancel()
            await asyncio.wait({self._writing})

    # --- from any thread

    def json(self, *, written: bool) -> dict[str, Any]:
        """Return the stop as answers have it; what is not written yet is told."""
        detail = ""
        if not written:
            why = f" ({self.failure})" if self.failure else ""
            detail = (
                f"in force on this instance; not on disk yet{why}, and written when that is possible: "
                "other instances hear of it then"
                if self.active
                else f"not on disk yet{why}"
            )
            with self._lock:
                if self._unwritten and not self._unwritten[-1].active:
                    detail = f"lifted as soon as that is on disk{why}; until then the stop stays"
        return {**stop_json(self._stop), "written": written, "detail": detail}

    @property
    def settled(self) -> bool:
        """Whether everything that was asked is on disk."""
        return not self._unwritten

    def ask(self, active: bool, *, by: str, reason: str) -> StopChange:
        """Stop, or lift the stop. A stop is in force when this returns, a lifting when it is written."""
        change = StopChange(active, by, reason, time.time_ns())
        with self._lock:
            self._changes += 1
            if active:
                self._stop = Stop(True, by, reason, change.asked_ns, self._stop.revision)
            if len(self._unwritten) >= MOST and self._unwritten[-1].active == active:
                change = self._unwritten[-1]
            else:
                self._unwritten.append(change)
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._take_up)
        return change

    # --- in the event loop

    def heard(self, stop: Stop) -> None:
        """Take note of what another instance wrote, or this one; of what came before what is known, not."""
        if stop.revision > self._stop.revision or not stop.revision:  # 0: of a version that did not count
            self._take(stop)

    def _take(self, stop: Stop) -> None:
        with self._lock:
            if any(change.active for change in self._unwritten):
                return  # ours is younger, and is going to be written
            self._changes += 1
            self._stop = stop
        self._tell()

    async def latest(self, within_s: float) -> Stop:
        """Return the stop, as the store has it if that can be had in time; for any event loop."""
        if self._loop is not None:
            looking = asyncio.run_coroutine_threadsafe(self.look(), self._loop)
            waiting = asyncio.wrap_future(looking)
            await asyncio.wait({waiting}, timeout=within_s)
            if waiting.done():
                waiting.exception()  # the store is away: what is known here counts
        return self._stop

    async def look(self) -> None:
        """Read the stop from the store, for an event that was lost with its database connection."""
        changes = self._changes
        stop = await self._store.read(global_stop.get)
        if stop.active != self._stop.active and changes == self._changes and not self._unwritten:
            self._take(stop)

    def _take_up(self) -> None:
        self._tell()
        if self._writing is None or self._writing.done():
            self._writing = asyncio.create_task(self._write(), name="writing the stop")

    def _tell(self) -> None:
        for callback in self._callbacks:
            callback()

    async def _write(self) -> None:
        """Write what is asked, oldest first, until nothing is left."""
        while self._unwritten:
            change = self._unwritten[0]
            try:
                stop = await self._store.write(partial(_write, change))
            except StoreError as error:
                if str(error) != self.failure:
                    log.warning("stop not written", active=change.active, code=error.code, detail=str(error))
                self.failure = str(error)
                await asyncio.sleep(AGAIN_S)
                continue
            except RobomendError as error:  # never to be written, as it is; a stop is in force all the same
                self._unwritten.popleft()
                change.written.set_exception(error)
                continue
            self.failure = ""
            with self._lock:
                self._unwritten.popleft()
                self._changes += 1
                if not any(other.active for other in self._unwritten):
                    self._stop = stop
            change.written.set_result(stop)
            self._tell()


def _write(change: StopChange, tx: Transaction) -> Stop:
    stop = global_stop.put(tx, change.active, by=change.by, reason=change.reason)
    tx.emit(Kind.STOP, None, {**stop_json(stop), "revision": stop.revision})
    late = tx.now_ns - change.asked_ns > LATE_S * 1e9
    tx.note(
        AuditEntry(
            change.by,
            "stop.set" if change.active else "stop.lifted",
            "all robots",
            None,
            change.reason,
            after={"asked_ns": change.asked_ns} if late else None,
        )
    )
    return stop


async def written(change: StopChange, within_s: float | None) -> bool:
    """Wait for a change to be on disk; return whether it is, after so long at most."""
    waiting = asyncio.wrap_future(change.written)
    await asyncio.wait({waiting}, timeout=within_s)
    if not waiting.done():
        waiting.add_done_callback(lambda late: late.cancelled() or late.exception())
        return False
    waiting.result()
    return True


def stop_json(stop: Stop) -> dict[str, Any]:
    """Return the stop as events and answers have it."""
    return {"active": stop.active, "by": stop.by, "reason": stop.reason, "since_ns": stop.since_ns}
