"""Ctrl-C as a fact to look at, not as an exception out of nowhere.

An exception that a signal throws between two instructions can skip the very clean-up it asks for. So a signal
here only makes a pipe readable; whoever waits, waits for the pipe as well and raises `Interrupted` from a
place where everything is in order.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import time
from types import FrameType, TracebackType
from typing import Any

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupted(Exception):
    """Somebody wants the command to end: a signal came."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


class Interrupts:
    """While this context lasts, signals that end a process are collected. For the main thread."""

    def __init__(self) -> None:
        self.came: int | None = None
        self._reader, self._writer = os.pipe()
        os.set_blocking(self._writer, False)
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Interrupts:
        for number in ENDING:
            self._before[number] = signal.signal(number, self._note)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)
        os.close(self._reader)
        os.close(self._writer)

    def check(self) -> None:
        """Raise Interrupted if a signal came."""
        if self.came is not None:
            raise Interrupted(self.came)

    def wait(self, seconds: float, reader: int | None = None) -> bool:
        """Wait until `reader` (a file descriptor) has something; False after the time.

        Raises:
            Interrupted: a signal came, before or meanwhile.
        """
        self.check()
        watched = [self._reader] if reader is None else [self._reader, reader]
        ready, _, _ = select.select(watched, [], [], max(0.0, seconds))
        self.check()
        return bool(ready)

    def poll(self, seconds: float, step_s: float = 0.02) -> SignalDeadline:
        """Return a loop condition: true every `step_s` until the time is over."""
        return SignalDeadline(self, seconds, step_s)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.came = self.came or number
        with contextlib.suppress(BlockingIOError):
            os.write(self._writer, b"!")


class SignalDeadline:
    """`while deadline.left(): …` looks again and again, until the time is over or a signal comes."""

    def __init__(self, interrupts: Interrupts, seconds: float, step_s: float) -> None:
        self._interrupts = interrupts
        self._end = time.monotonic() + seconds
        self._step_s = step_s
        self._first = True

    def left(self) -> bool:
        """Wait a step, except the first time; return whether there is time left."""
        self._interrupts.check()
        if self._first:
            self._first = False
            return True
        if time.monotonic() >= self._end:
            return False
        self._interrupts.wait(self._step_s)
        return True
