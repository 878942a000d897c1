"""A coroutine that begins at once, and not in a later turn of the event loop, as a task does.

What is begun for each of a thousand batches a second comes to its write in the turn in which it came in, and
costs no turn of its own. Python 3.12 has eager tasks for this; 3.11 has not. To what runs in it this is a
task, as asyncio lets others make them ("Extending asyncio" in Python's documentation): `asyncio.timeout`,
cancellation and context variables work as they do there.
"""

from __future__ import annotations

import asyncio
from asyncio import _enter_task, _leave_task
from collections.abc import Callable, Coroutine
from contextvars import copy_context
from time import thread_time
from typing import Any

ENDED: Any = object()


class Eager:
    """A coroutine under way, which nobody waits for."""

    __slots__ = (
        *("__weakref__", "_among", "_awaited", "_cancels", "_context", "_longest_s", "_loop", "_note"),
        *("_to_cancel", "_work"),
    )

    def __init__(
        self,
        work: Coroutine[Any, Any, None],
        loop: asyncio.AbstractEventLoop,
        among: set[Any],
        note: Callable[[float], None] | None = None,
    ) -> None:
        """Begin. No task may be running.

        Args:
            among: has this as long as it is under way.
            note: takes the longest time of the processor between two awaits (loop_watch.py), at the end.
        """
        self._work = work
        self._note = note
        self._longest_s = 0.0
        self._loop = loop
        self._among = among
        self._context = copy_context()
        self._awaited: asyncio.Future[Any] | None = None
        self._cancels = 0
        self._to_cancel = False
        among.add(self)
        self._context.run(self._go_on, None)

    def cancel(self, msg: object = None) -> bool:
        """Have the coroutine cancelled where it waits; False: it has ended."""
        if self not in self._among:
            return False
        self._cancels += 1
        if self._awaited is None or not self._awaited.cancel(msg):
            self._to_cancel = True
        return True

    def cancelling(self) -> int:
        """Return how often it was cancelled, less what was taken back."""
        return self._cancels

    def uncancel(self) -> int:
        """Take a cancellation back; return how many are left."""
        self._cancels = max(0, self._cancels - 1)
        return self._cancels

    def _go_on(self, awaited: asyncio.Future[Any] | None) -> None:
        """Run to the next thing that is waited for; a future itself says in the coroutine what came of it."""
        _enter_task(self._loop, self)  # type: ignore[arg-type]  # all that asyncio asks of one
        self._awaited = failed = None
        began_s = thread_time()
        try:
            awaits = self._cancelled() if self._to_cancel else self._work.send(None)
        except StopIteration:
            awaits = ENDED
        except BaseException as error:  # noqa: BLE001  # as a task has it
            awaits, failed = ENDED, error
        held_s = thread_time() - began_s
        if held_s > self._longest_s:
            self._longest_s = held_s
        _leave_task(self._loop, self)  # type: ignore[arg-type]  # as above
        if awaits is not ENDED:
            self._await(awaits)
            return
        self._among.discard(self)
        if self._note is not None:
            self._note(self._longest_s)
        if failed is not None:
            self._tell(failed)

    def _cancelled(self) -> Any:
        self._to_cancel = False
        return self._work.throw(asyncio.CancelledError())

    def _await(self, awaits: asyncio.Future[Any] | None) -> None:
        if awaits is None:  # only a turn of the loop
            self._loop.call_soon(self._go_on, None, context=self._context)
            return
        awaits._asyncio_future_blocking = False
        awaits.add_done_callback(self._go_on, context=self._context)
        self._awaited = awaits
        if self._to_cancel and awaits.cancel():
            self._to_cancel = False

    def _tell(self, error: BaseException) -> None:
        if isinstance(error, KeyboardInterrupt | SystemExit):
            raise error
        if not isinstance(error, asyncio.CancelledError):
            self._loop.call_exception_handler({"message": "an eager task failed", "exception": error})
