"""Processes that hang: stopped by a signal, and let go on."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress


@contextmanager
def frozen(*pids: int) -> Iterator[None]:
    """None of these processes runs. Who starts others comes first, so that it starts none from here on."""
    try:
        for pid in pids:
            os.kill(pid, signal.SIGSTOP)
        yield
    finally:
        for pid in reversed(pids):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)


@contextmanager
def starved(*pids: int, halted_s: float = 0.12, runs_s: float = 0.08) -> Iterator[None]:
    """These processes run now and then only, as on a computer that has more to do than it can."""
    ends = threading.Event()

    def hinder() -> None:
        while not ends.is_set():
            with suppress(ProcessLookupError), frozen(*pids):
                ends.wait(halted_s)
            ends.wait(runs_s)

    hindering = threading.Thread(target=hinder)
    hindering.start()
    try:
        yield
    finally:
        ends.set()
        hindering.join()
