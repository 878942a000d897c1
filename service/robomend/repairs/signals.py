"""What reaches a running repair from outside: a yes, a cancellation, the global stop.

Requests wait in the store and are handed over by the running. One stays there until what came of it is
written (`RepairRecord.update(answers=…)`), so that a crash in between loses neither a yes nor a cancellation.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from typing import TypeVar

T = TypeVar("T")

NO_REASON = "cancelled"
"""The reason of a cancellation that gives none."""


class Halted(Exception):  # what happened, not what went wrong
    """Ends a wait that is not the execution's own."""


class Declined(Halted):
    """A person answered a question with a cancellation."""


class Signals:
    """See the module; one per repair that is carried out."""

    def __init__(self) -> None:
        self.halt = asyncio.Event()  # cancelled, or the global stop
        self.by = ""  # who approved, then who halted
        self.reason = ""  # of the halt
        self.stopped = False  # by the global stop
        self.halted_by: int | None = None  # the cancellation, None: the global stop
        self._yes = asyncio.Event()
        self._approval: int | None = None  # the request that a yes came with
        self._seen: set[int] = set()
        self._unanswered: set[int] = set()

    def end(self, *, by: str, reason: str, request: int | None = None, stop: bool = False) -> None:
        """Send nothing more, and cut off what runs."""
        if request is not None:
            self._note(request)
        if not self.halt.is_set():
            self.by, self.reason, self.stopped, self.halted_by = by, reason, stop, request
            self.halt.set()

    def approve(self, *, by: str, request: int) -> None:
        """A person said yes; the same request counts once."""
        if self._note(request):
            self.by, self._approval = by, request
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
        self._approval = None

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
