"""What reaches a running repair from outside: a yes, a cancellation, the global stop.

Requests wait in the store and are handed over by the running. One stays there until what came of it is
written (`RepairRecord.update(answers=…)`), so that a crash in between loses neither a yes nor a cancellation.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from functools import partial
from typing import TypeVar

import structlog

from robomend.errors import RobomendError
from robomend.store import Store, Transaction, repairs
from robomend.store.records import Fence

log = structlog.get_logger("robomend.repairs.signals")

T = TypeVar("T")

LOOK_AGAIN_S = 1.0
"""An event tells of a request; this is for one that was lost."""

NO_REASON = "cancelled"
"""The reason of a cancellation that gives none."""


class Halted(Exception):  # what happened, not what went wrong
    """Ends a wait that is not the execution's own."""


class Declined(Halted):
    """A person answered a question with a cancellation."""


class Halt(asyncio.Event):
    """Set when a repair is to send nothing more; also while the global stop is active.

    Whoever asks sees the stop from the moment on in which it was set, in whatever thread that was; those who
    wait are woken by the event loop, when it comes to it.
    """

    def __init__(self, stopped: Callable[[], bool]) -> None:
        super().__init__()
        self._stopped = stopped

    def is_set(self) -> bool:
        return super().is_set() or self._stopped()


class Signals:
    """See the module; one per repair that is carried out."""

    def __init__(self, stopped: Callable[[], bool] = lambda: False) -> None:
        """`stopped` tells whether the global stop is active, at any moment."""
        self.halt = Halt(stopped)  # cancelled, or the global stop
        self.by = ""  # who approved, then who halted
        self.reason = ""  # of the halt
        self.stopped = False  # by the global stop
        self.halted_by: int | None = None  # the cancellation, None: the global stop
        self._ended = False
        self._yes = asyncio.Event()
        self._seen: set[int] = set()
        self._unanswered: set[int] = set()

    def end(self, *, by: str, reason: str, request: int | None = None, stop: bool = False) -> None:
        """Send nothing more, and cut off what runs."""
        if request is not None:
            self._note(request)
        if not self._ended:
            self.by, self.reason, self.stopped, self.halted_by = by, reason, stop, request
            self._ended = True
            self.halt.set()

    def approve(self, *, by: str, request: int) -> None:
        """A person said yes; the same request counts once."""
        if self._note(request):
            self.by = by
            self._yes.set()

    def _note(self, request: int) -> bool:
        if request in self._seen:
            return False
        self._seen.add(request)
        self._unanswered.add(request)
        return True

    def ask(self) -> None:
        """A new question is about to be put: a yes to an earlier one is no answer to it."""
        self._yes.clear()

    async def decided(self, timeout_s: float | None = None) -> bool:
        """Wait for a yes (True) or a halt (False); False after the time-out as well."""
        waits = [asyncio.create_task(event.wait()) for event in (self._yes, self.halt)]
        try:
            await asyncio.wait(waits, timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for wait in waits:
                wait.cancel()
        return self._yes.is_set() and not self.halt.is_set()

    async def unless_halted(self, wait: Awaitable[T]) -> T:
        """Return what is waited for; Halted as soon as the halt comes, and the wait is cancelled then."""
        waiting = asyncio.ensure_future(wait)
        halted = asyncio.create_task(self.halt.wait())
        try:
            await asyncio.wait({waiting, halted}, return_when=asyncio.FIRST_COMPLETED)
            if self.halt.is_set():
                raise Halted
            return waiting.result()
        finally:
            waiting.cancel()
            halted.cancel()
            await asyncio.wait({waiting, halted})  # nothing of it goes on behind our back

    def answers(self) -> tuple[int, ...]:
        """Return the requests that the next write answers."""
        numbers = tuple(sorted(self._unanswered))
        self._unanswered.clear()
        return numbers


class Requests:
    """Hands what somebody asked for, through whichever instance, to the repair that runs; one per robot."""

    def __init__(self, store: Store, fence: Fence) -> None:
        self.arrived = asyncio.Event()  # there may be one
        self._store = store
        self._fence = fence

    async def listen(self, repair: str, signals: Signals) -> None:
        """Hand requests from the store to a running repair, for ever."""
        while True:
            self.arrived.clear()
            try:
                await self._hand_over(repair, signals)
            except RobomendError as error:
                log.warning(
                    "requests were not read", robot=self._fence.robot, code=error.code, detail=str(error)
                )
            except Exception:  # else nobody could cancel any more
                log.exception("requests were not read", robot=self._fence.robot)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(LOOK_AGAIN_S):
                    await self.arrived.wait()

    async def _hand_over(self, repair: str, signals: Signals) -> None:
        for request in await self._store.read(repairs.requests, self._fence.robot):
            if repairs.is_change(request.repair) != repairs.is_change(repair):
                continue  # a repair and a change of configuration may be open side by side
            if request.repair != repair:  # that one has ended
                await self._store.write(partial(_answer, request.number, self._fence))
            elif request.what == "approve":
                signals.approve(by=request.by, request=request.number)
            else:
                signals.end(by=request.by, reason=request.reason or NO_REASON, request=request.number)


def _answer(request: int, fence: Fence, tx: Transaction) -> None:
    repairs.answer(tx, request, fence=fence)
