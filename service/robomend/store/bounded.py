"""A connection to PostgreSQL that waits for no answer for ever.

A server that lives ends a statement by itself (`statement_timeout`), and a computer that is gone is noticed
by TCP. One that is frozen (SIGSTOP, a disk that hangs, a machine that is suspended, whose kernel or proxy
still takes what is sent) does neither: nothing comes, and no error. After `answer_s` without a byte the
connection is closed here, as one that was lost, and whoever needs one opens another.

Imported where PostgreSQL is used: its driver is an extra.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from typing import Any, Self, TypeVar

import psycopg

T = TypeVar("T")

ANSWER_S = 35.0
"""Of a server that lives, something comes after 30 s: that is its `statement_timeout`."""

NOTHING = 0  # the driver's READY_NONE: it has looked, and the socket is not ready


class BoundedConnection(psycopg.Connection[Any]):
    """See the module."""

    answer_s: float = ANSWER_S

    @contextmanager
    def patient(self, answer_s: float) -> Iterator[Self]:
        """Wait for so long meanwhile: for what may take its time."""
        before, self.answer_s = self.answer_s, answer_s
        try:
            yield self
        finally:
            self.answer_s = before

    def wait(self, gen: Generator[Any, Any, T], *args: Any, **kwargs: Any) -> T:
        """Let the driver wait for what `gen` does, as long as something comes.

        Raises:
            psycopg.OperationalError: nothing did.
        """
        return super().wait(self._watched(gen), *args, **kwargs)

    def _watched(self, gen: Generator[Any, Any, T]) -> Generator[Any, Any, T]:
        """Do what `gen` does. The driver says now and then that nothing has come: we count since when."""
        heard_s = time.monotonic()
        try:
            wanted = next(gen)
            while True:
                ready = yield wanted
                now_s = time.monotonic()
                if ready != NOTHING:
                    heard_s = now_s
                elif now_s - heard_s > self.answer_s:
                    self.close()  # nobody knows what is under way on it
                    raise psycopg.OperationalError(f"the server has said nothing for {self.answer_s:g} s")
                wanted = gen.send(ready)
        except StopIteration as end:
            found: T = end.value
            return found
