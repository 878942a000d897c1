"""Worker processes: each diagnoses one file after another, and may die of one.

    run ──► file ──► worker ──► records ──► run
             └── the worker died: a new one, and the file again, MOST_DEATHS times; then the file is left out

Engines do not pickle, the system description does. A worker whose run is gone ends.
"""

from __future__ import annotations

import math
import signal
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any

from robomend_batch.errors import FULL, DiskFull
from robomend_batch.garbage import collect_less
from robomend_batch.one_log import Diagnoser, Record, Setup, refused
from robomend_batch.problems import Problems
from robomend_batch.starting import END_S, Started, start

MOST_DEATHS = 3
"""Workers that a file may cost."""

Share = Callable[[str, float], None]
"""Told how much of a file that is in hand is read."""


def in_this_process(
    setup: Setup, names: Sequence[str], on_share: Share = lambda name, share: None
) -> Iterator[tuple[str, list[Record]]]:
    """Diagnose files one after another, without a worker."""
    diagnoser = Diagnoser(setup)
    try:
        for name in names:
            diagnoser.on_share = partial(on_share, name)
            yield name, diagnoser.diagnose(name)
    finally:
        diagnoser.close()


@dataclass
class _Worker:
    process: SpawnProcess
    pipe: Connection
    place: int
    name: str | None = None  # the file that it has in hand


@dataclass
class _Pool:
    setup: Setup
    waiting: deque[str]
    begun: list[Started]  # that have no Setup yet
    count: int
    workers: list[_Worker] = field(default_factory=list)
    deaths: dict[str, int] = field(default_factory=dict)

    def start(self, place: int) -> None:
        """Start a worker, if none is begun, and give it a file."""
        begun = next((one for one in self.begun if one.place == place), None)
        if begun is None:
            begun = start(self.count, place)
        else:
            self.begun.remove(begun)
        worker = _Worker(begun.process, begun.pipe, place)
        self.workers.append(worker)
        with suppress(OSError):  # it has died: that is seen where its answer is waited for
            worker.pipe.send(self.setup)
        self.give(worker)

    def give(self, worker: _Worker) -> None:
        """Give a worker the next file, or let it end."""
        worker.name = self.waiting.popleft() if self.waiting else None
        try:
            worker.pipe.send(worker.name)
        except OSError:  # it has died: that is seen where its answer is waited for
            return
        if worker.name is None:
            self.workers.remove(worker)
            worker.pipe.close()
            worker.process.join(END_S)

    def buried(self, worker: _Worker) -> list[Record] | None:
        """Replace a worker that died; return the record of its file if that is left out."""
        worker.process.join(END_S)
        self.workers.remove(worker)
        worker.pipe.close()
        name, records = worker.name, None
        assert name is not None
        self.deaths[name] = self.deaths.get(name, 0) + 1
        if self.deaths[name] < MOST_DEATHS:
            self.waiting.appendleft(name)
        else:
            records = [lost(name, f"it cost {MOST_DEATHS} workers: {_end_of(worker.process)}")]
        if self.waiting:
            self.start(worker.place)
        return records

    def end(self) -> None:
        """End what still runs."""
        for worker in self.workers:
            worker.process.kill()
        for worker in self.workers:
            worker.process.join(END_S)
            worker.pipe.close()


def in_workers(
    setup: Setup,
    names: Sequence[str],
    workers: int,
    on_share: Share = lambda name, share: None,
    begun: list[Started] | None = None,
) -> Iterator[tuple[str, list[Record]]]:
    """Diagnose files in so many worker processes; yield each as it is done.

    Args:
        setup: of each.
        names: of the files.
        workers: processes.
        on_share: told how much of a file is read.
        begun: workers that are there already; those that are needed are taken from it.

    Raises:
        DiskFull: a worker could not write its results.
    """
    pool = _Pool(setup, deque(names), [] if begun is None else begun, workers)
    try:
        for place in range(min(workers, len(names))):
            pool.start(place)
        while pool.workers:
            for pipe in wait([worker.pipe for worker in pool.workers]):
                worker = next(worker for worker in pool.workers if worker.pipe is pipe)
                name = worker.name
                try:
                    kind, told = worker.pipe.recv()
                except (EOFError, OSError):
                    if (records := pool.buried(worker)) is not None:
                        yield str(name), records
                    continue
                if kind == "full":
                    raise DiskFull(told)
                if kind == "share":
                    on_share(str(name), told)
                    continue
                pool.give(worker)
                yield str(name), told if kind == "done" else [lost(str(name), told)]
    finally:
        pool.end()


def lost(name: str, reason: str) -> Record:
    """Return the record of a file that no worker survived."""
    problems = Problems()
    problems.add(name, reason, bad=True)
    return refused(name, None, problems, "lost")


def _end_of(process: SpawnProcess) -> str:
    code = process.exitcode
    if code is not None and code < 0:
        return f"killed by {signal.Signals(-code).name}"
    return f"ended with {code}"


def work(pipe: Connection) -> None:
    """Run in the worker."""
    collect_less()
    try:
        setup: Setup = pipe.recv()
    except EOFError:
        return
    diagnoser = Diagnoser(setup, lambda share: pipe.send(("share", share)))
    try:
        while (name := pipe.recv()) is not None:
            pipe.send(told_of(diagnoser, name))
    except (EOFError, BrokenPipeError):
        return
    finally:
        diagnoser.close()


def told_of(diagnoser: Diagnoser, name: str, span_s: float = math.inf) -> tuple[str, Any]:
    """Return what became of a file: done, full or failed, with its records or the reason.

    Or, if it was not done in so many seconds, unfinished.
    """
    try:
        records = diagnoser.diagnose_for(name, span_s)
        return ("unfinished", None) if records is None else ("done", records)
    except OSError as error:
        if error.errno in FULL:
            return "full", str(error)
        return "failed", f"{type(error).__name__}: {error}"
    except Exception as error:  # noqa: BLE001  # a bug costs the log, not the run
        frames = traceback.extract_tb(error.__traceback__)
        place = f" ({frames[-1].filename}:{frames[-1].lineno})" if frames else ""
        return "failed", f"{type(error).__name__}: {error}{place}"
