"""What Python 3.10, that of Ubuntu 22.04 and ROS 2 Humble, does not have yet: StrEnum, a time-out for a
block, and cancellations that cannot be lost.

From 3.11 on they are the standard library's. The client uses no other novelty of 3.11; the tests run it on
3.10.
"""

from __future__ import annotations

import asyncio
import enum
import sys
from collections.abc import Iterable
from types import TracebackType
from typing import Any

if sys.version_info >= (3, 11):
    from asyncio import timeout
    from enum import StrEnum
else:

    class StrEnum(str, enum.Enum):
        """An enumeration of texts."""

        __str__ = str.__str__
        __format__ = str.__format__

    class timeout:  # noqa: N801  # asyncio's name
        """`async with timeout(seconds)`: cancels the block when time is up, and raises TimeoutError instead.

        A cancellation from outside that comes in the same turn of the loop as the end of the time counts as a
        time-out: 3.10 cannot tell the two apart. Whoever cancels a task for good cancels it again.
        """

        def __init__(self, seconds: float | None) -> None:
            self._seconds = seconds
            self._handle: asyncio.TimerHandle | None = None
            self._expired = False

        async def __aenter__(self) -> timeout:
            task = asyncio.current_task()
            if task is None:
                raise RuntimeError("a time-out needs a task")
            if self._seconds is not None:
                self._handle = asyncio.get_running_loop().call_later(
                    max(0.0, self._seconds), self._expire, task
                )
            return self

        def _expire(self, task: asyncio.Task[object]) -> None:
            self._expired = True
            task.cancel()

        async def __aexit__(
            self,
            kind: type[BaseException] | None,
            error: BaseException | None,
            trace: TracebackType | None,
        ) -> None:
            if self._handle is not None:
                self._handle.cancel()
            if self._expired and kind is asyncio.CancelledError:
                raise TimeoutError from error


AGAIN_S = 2.0
"""Long enough for what a cancelled task has to put away."""


async def end(tasks: Iterable[asyncio.Future[Any]]) -> None:
    """Cancel tasks, and wait until all have ended; what they raise is theirs.

    On 3.10 a task cannot tell its own cancellation from that of a part of its work that comes in the same
    turn, so anyio swallows it (while it connects, for one). It is said again, until it is heard.
    """
    pending = set(tasks)
    while pending:
        for task in pending:
            task.cancel()
        _, pending = await asyncio.wait(pending, timeout=AGAIN_S)


__all__ = ["StrEnum", "end", "timeout"]
