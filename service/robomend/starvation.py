"""How long a process was kept from the processor: what the machine does to it is no fault of its own.

Whoever judges that a process hangs counts its silence without the time in which its threads were ready and
the kernel ran others. A stopped thread, one that sleeps, and one that computes are not kept from anything.

    silence by the clock  −  time that its threads waited for a processor  =  silence of its own

Reference: Documentation/scheduler/sched-stats.rst of Linux, /proc/<pid>/schedstat.
"""

from __future__ import annotations

import contextlib
import os

AT_MOST_S = 30.0
"""So much is excused; after that it does not matter whose fault it is."""


def waited_s(process: int | None = None) -> float:
    """Return how long the threads of a process (None: of this one) have waited for a processor, in sum.

    Threads that have ended are not in it. 0 where the kernel does not say, or there is no such process.
    """
    waited_ns = 0
    threads = f"/proc/{process or 'self'}/task"
    with contextlib.suppress(OSError):  # no such process
        for thread in os.listdir(threads):
            with contextlib.suppress(OSError, IndexError):  # it ended just now
                waited_ns += int(_read(f"{threads}/{thread}/schedstat").split()[1])
    return waited_ns / 1e9


def _read(path: str) -> bytes:
    """Return a short file, three times as fast as an object for it: it is read for each thread, often."""
    file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        return os.read(file, 100)
    finally:
        os.close(file)


class OwnSilence:
    """The silence of a process that says something now and then, without what it was kept from."""

    def __init__(self, now_s: float, waited_s: float) -> None:
        """Both as of its last word, or a little before."""
        self._heard_s = now_s
        self._waited_s = waited_s

    def excused_s(self, now_s: float, waited_s: float) -> float:
        """Return how much of its silence was no fault of its own."""
        return min(max(0.0, waited_s - self._waited_s), now_s - self._heard_s, AT_MOST_S)
