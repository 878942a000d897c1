"""Worker processes that are begun before the run knows what to give them: all load code at the same time.

    command ──► names of the logs ──► model, observers, folder ─────────► first file to each
                    └──► workers: interpreter, numpy, the rest of robomend ──┘

So this imports nothing of what they load. They are spawned, so that they begin with nothing of ours in a
strange state, and never hear of Ctrl-C, which is the run's business.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess

from robomend.workers.parent import die_with_parent

END_S = 5.0


@dataclass(frozen=True, slots=True)
class Started:
    """A worker that waits for its Setup, and then for files."""

    process: SpawnProcess
    pipe: Connection
    place: int  # among the workers; who takes its place has its core


def usable_cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def start(workers: int, place: int) -> Started:
    """Start a worker, one of so many.

    If there is one for each core, each stays on its own: one that is moved to and fro finds nothing in the
    caches. If they are fewer, nobody stays anywhere, or two such runs would share some and leave others idle.
    """
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    cores = usable_cores()
    threads = max(1, cores // workers)
    alone = workers == cores and hasattr(os, "sched_setaffinity")
    core = sorted(os.sched_getaffinity(0))[place] if alone else None
    process = context.Process(target=_work, args=(theirs, threads, core), daemon=True)
    with _without_ctrl_c():
        process.start()
    theirs.close()
    return Started(process, ours, place)


@contextmanager
def started(workers: int) -> Iterator[list[Started]]:
    """Start so many workers; those that nobody has taken by the end are ended."""
    waiting = [start(workers, place) for place in range(workers)]
    try:
        yield waiting
    finally:
        for worker in waiting:
            worker.process.kill()
        for worker in waiting:
            worker.process.join(END_S)
            worker.pipe.close()


@contextmanager
def _without_ctrl_c() -> Iterator[None]:
    """What is started meanwhile hears nothing of Ctrl-C."""
    resource_tracker.ensure_running()  # the first process that is started lets signals through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _work(pipe: Connection, threads: int, core: int | None) -> None:
    die_with_parent()
    if core is not None:
        with suppress(OSError):  # it was taken from us since
            os.sched_setaffinity(0, {core})
    os.environ["POLARS_MAX_THREADS"] = str(threads)  # before it is imported
    from robomend_batch.pool import work

    work(pipe)
