"""The entry point of `robomend`, and all that is imported before Ctrl-C is looked after: see commands.py."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable

INTERRUPTED = 130

SOON_S = 0.01
"""Until a Ctrl-C that was lost is sent again: what swallowed it is a few instructions long."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its code."""

    def program() -> int:
        from robomend.cli.commands import run

        return run(sys.argv[1:] if arguments is None else arguments)

    sys.exit(interruptible(program))


def interruptible(program: Callable[[], int]) -> int:
    """Run a program and return its exit code; 130 after Ctrl-C, which is never lost.

    Python prints and forgets an exception that comes inside a finalizer or the callback of a weak reference,
    and imports are full of them: one early Ctrl-C in some hundreds did nothing.
    """
    sys.unraisablehook = _lost
    try:
        return program()
    except KeyboardInterrupt:  # while the rest was being imported; `run` has the others
        return INTERRUPTED


def _lost(unraisable: sys.UnraisableHookArgs) -> None:
    """Send a Ctrl-C again that was dropped; tell of everything else as Python does."""
    if unraisable.exc_type is KeyboardInterrupt:
        threading.Thread(target=_interrupt_soon, daemon=True).start()  # here it would be dropped again
    else:
        sys.__unraisablehook__(unraisable)


def _interrupt_soon() -> None:
    main_thread = threading.main_thread().ident
    assert main_thread is not None  # it has begun
    time.sleep(SOON_S)
    while _inside_lost(main_thread):  # kept from the processor: there it would be dropped again, and not told
        time.sleep(SOON_S)
    signal.pthread_kill(main_thread, signal.SIGINT)


def _inside_lost(thread: int) -> bool:
    """Return whether a thread is still in `_lost`, or in what that calls."""
    frame = sys._current_frames().get(thread)
    while frame is not None and frame.f_code is not _lost.__code__:
        frame = frame.f_back
    return frame is not None
