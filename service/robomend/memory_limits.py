"""Room for what begins: memory, and the stacks of threads.

Where address space is bounded (`ulimit -v`), it may end in the middle of anything. So what begins with many
threads asks first whether they fit, and is refused as a whole where they do not.

The C library has a region of 64 MB for the memory of nearly each thread; most of it is never used, but it
counts. Where address space is bounded, all threads share two (mallopt(3), M_ARENA_MAX).
"""

from __future__ import annotations

import _thread  # noqa: PLC2701  # documented; its name alone is private
import contextlib
import ctypes
import mmap
import os
import resource
import threading

from robomend.errors import BackendError

ARENAS = 2

BEGUN_S = 10.0
"""A thread that has not begun in so long, on a busy machine, too, found no memory."""

_M_ARENA_MAX = -8
"""Of malloc.h."""


def memory_unlimited() -> bool:
    """Return whether this process may have as much address space as there is.

    Where it may not, solvers work in processes of their own only: one that runs out of memory throws what
    nobody catches, and its process is gone.
    """
    return resource.getrlimit(resource.RLIMIT_AS)[0] == resource.RLIM_INFINITY


def share_arenas() -> None:
    """Have the threads of this process, and of those that it starts, share what memory they have."""
    os.environ.setdefault("MALLOC_ARENA_MAX", str(ARENAS))
    with contextlib.suppress(AttributeError):  # another C library has no such regions
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, ARENAS)


def out_of_memory(error: BaseException) -> bool:
    """Whether it says that there is no room for what is asked: memory, or the stack of another thread."""
    return isinstance(error, MemoryError) or str(error) == "can't start new thread"


def no_room(what: str) -> BackendError:
    """Return the error of what there is no room for."""
    return BackendError(f"no room for {what}: this process may have no more memory (`ulimit -v`, a cgroup)")


def check_room(what: str, threads: int, megabytes: int) -> None:
    """Have so many threads at once, and so much memory beside them, and let them go again.

    Raises:
        BackendError: they do not fit.
    """
    enough = threading.Event()
    begun, ended = threading.Semaphore(0), threading.Semaphore(0)

    def wait() -> None:
        begun.release()
        enough.wait()
        ended.release()

    there = 0
    try:
        for _ in range(threads):
            # A Thread's start() waits for ever for one that found no memory for its first step.
            _thread.start_new_thread(wait, ())
            if not begun.acquire(timeout=BEGUN_S):
                raise MemoryError
            there += 1
        with mmap.mmap(-1, megabytes << 20):
            pass
    except (MemoryError, OSError, RuntimeError) as error:
        raise no_room(what) from error
    finally:
        enough.set()
        for _ in range(there):
            ended.acquire(timeout=BEGUN_S)
