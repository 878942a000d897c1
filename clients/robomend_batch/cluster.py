"""An existing Dask cluster in place of processes of this computer: `--scheduler tcp://…`.

    run ──► file ──► scheduler ──► worker: the file is read there ──► records and parts ──► run: OUT

A worker reads the log by the same path as here, so it must see it; it needs nothing of OUT, as what it found
comes back whole. A log that takes longer than SPAN_S comes back with its state and is handed out again, to go
on from there. A worker that dies costs what it had in hand, which the scheduler gives to another. If the
scheduler dies, what came back is kept, and the same command goes on.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import pickle
import socket
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robomend_batch.errors import FULL, DiskFull, SchedulerFailed
from robomend_batch.manifest import write_beside
from robomend_batch.observing import digest
from robomend_batch.one_log import RESULTS, Diagnoser, Record, Setup, state_file
from robomend_batch.parts import write_piece
from robomend_batch.pool import lost, told_of
from robomend_batch.unfinished import ENDING, Stamp, stamp

if TYPE_CHECKING:
    from distributed import Client, Future

CONNECT_S = 10.0
WORKERS_S = 60.0
"""Without a single worker, a run is given up."""
LOOK_S = 2.0
TRIES = 6
"""To have an outcome handed over, for CONNECT_S each: who has it may be frozen, or gone unnoticed."""

SPAN_S = 5.0
"""Of a log that is in hand."""

_AGAIN = "what came back is kept, and the same command goes on with another"

AHEAD = 4
"""Files that are handed out for each thread of the cluster."""

START = "start one: `dask scheduler`, and on each computer `dask worker tcp://HOST:8786 --nthreads 1`"

PACKAGES = ("robomend", "polars", "numpy", "rosbags", "mcap", "distributed")
"""Results, or what travels, depend on their versions."""

Task = tuple[str, Any, dict[str, bytes]]
"""Kind of outcome, what was told, and the parts by their names."""


def in_cluster(setup: Setup, names: Sequence[str], address: str) -> Iterator[tuple[str, list[Record]]]:
    """Diagnose files on the workers of a scheduler; yield each as it is done.

    Raises:
        SchedulerFailed: it cannot be reached, has no workers, other versions, or does not see the files.
        DiskFull: a worker, or this computer, has no room for the results.
    """
    client = _connected(address)
    try:
        _check_versions(client, address)
        yield from _run(client, setup, names, address)
    except (OSError, RuntimeError, TimeoutError, CancelledError) as error:
        if isinstance(error, OSError) and error.errno in FULL:
            raise
        why = str(error).partition("\n")[0].rstrip(":") or type(error).__name__
        raise SchedulerFailed(f"the scheduler at {address} is gone: {why}; {_AGAIN}") from error
    finally:
        with contextlib.suppress(OSError, RuntimeError, TimeoutError, CancelledError):  # it may be gone
            client.close(timeout=CONNECT_S)


def _connected(address: str) -> Client:
    try:
        from distributed import Client
    except ImportError:
        raise SchedulerFailed("--scheduler needs distributed: pip install 'robomend[batch,dask]'") from None
    for logger in ("distributed", "distributed.client"):  # both have levels of their own
        logging.getLogger(logger).setLevel(logging.CRITICAL)  # what is wrong is said once, by us
    try:
        client = Client(address, timeout=CONNECT_S)
    except (OSError, ValueError, TimeoutError) as error:
        raise SchedulerFailed(f"no Dask scheduler is reached at {address}: {START}") from error
    try:
        client.wait_for_workers(1, timeout=CONNECT_S)
    except TimeoutError:
        client.close(timeout=CONNECT_S)
        raise SchedulerFailed(f"the scheduler at {address} has no workers: {START}") from None
    return client


def _check_versions(client: Client, address: str) -> None:
    """Refuse workers that would read or answer otherwise than we do."""
    ask = _asks_versions(PACKAGES)
    ours = ask()
    for worker, theirs in client.run(ask, on_error="return").items():
        if isinstance(theirs, BaseException):
            raise SchedulerFailed(f"worker {worker} cannot be asked for its versions: {theirs}")
        differ = [
            f"{name} {theirs.get(name)} (here {ours[name]})"
            for name in ours
            if theirs.get(name) != ours[name]
        ]
        if differ:
            said = ", ".join(differ)
            raise SchedulerFailed(
                f"worker {worker} of {address} has {said}: install the same on all computers"
            )


def _asks_versions(packages: tuple[str, ...]) -> Callable[[], dict[str, str]]:
    """Return a function that travels by its code: a worker may lack this module."""

    def ask() -> dict[str, str]:
        import platform
        from importlib.metadata import PackageNotFoundError, version

        found = {"python": ".".join(platform.python_version_tuple()[:2])}
        for package in packages:
            try:
                found[package] = version(package)
            except PackageNotFoundError:
                found[package] = "none"
        return found

    return ask


def _run(
    client: Client, setup: Setup, names: Sequence[str], address: str
) -> Iterator[tuple[str, list[Record]]]:
    from distributed import wait

    observers = None if setup.observers is None else setup.observers.resolve()
    work = pickle.dumps((replace(setup, observers=observers, ndjson=False), digest(observers)))
    waiting, seen_s = list(reversed(names)), time.monotonic()
    open_ones: dict[Future[Task], str] = {}
    tries: Counter[str] = Counter()
    while waiting or open_ones:
        threads = _threads(client)
        if threads:
            seen_s = time.monotonic()
        elif time.monotonic() - seen_s >= WORKERS_S:
            raise SchedulerFailed(
                f"the scheduler at {address} has named no worker for {WORKERS_S:g} s: {START}"
            )
        while waiting and len(open_ones) < AHEAD * max(threads, 1):
            name = waiting.pop()
            given = work, name, stamp(name), os.getcwd(), _state(setup, name), SPAN_S
            open_ones[client.submit(diagnose, *given, pure=False, retries=0)] = name
        try:
            done = wait(list(open_ones), timeout=LOOK_S, return_when="FIRST_COMPLETED").done
        except TimeoutError:
            done = set()
        for future in sorted(done, key=lambda one: open_ones[one]):
            name = open_ones[future]
            try:
                records = _records(future, name, setup, address)
            except _Anew as again:
                tries[name] += 1
                if tries[name] >= TRIES:
                    raise SchedulerFailed(f"{address}: {again}; {_AGAIN}") from again
                continue
            del open_ones[future], tries[name]
            if records is None:
                waiting.append(name)
            else:
                yield name, records


def _state(setup: Setup, name: str) -> bytes | None:
    """Return the state of a log that is unfinished."""
    try:
        return state_file(setup.out, name).read_bytes()
    except OSError:
        return None


def _threads(client: Client) -> int:
    """Return how many threads the workers have; 0 also where a busy scheduler does not say in time."""
    if client.status != "running":
        return 0
    try:
        return sum(client.nthreads(callback_timeout=CONNECT_S).values())
    except TimeoutError:
        return 0


class _Anew(Exception):
    """The worker that had an outcome died before we had it, and another one works it out again; or it has it
    still, and does not hand it over in time.
    """


def _records(future: Future[Task], name: str, setup: Setup, address: str) -> list[Record] | None:
    """Return what became of a file, its parts written; None if it is unfinished."""
    from distributed import KilledWorker

    slow = f"no worker hands over what became of {name}"
    if future.status == "lost" and future.client.status == "running":
        raise _Anew(slow)
    if future.status in {"cancelled", "lost"}:
        raise SchedulerFailed(f"the scheduler at {address} is gone: {_AGAIN}")
    try:
        kind, told, parts = future.result(timeout=CONNECT_S)
    except KilledWorker as error:
        return [lost(name, f"it cost {error.allowed_failures + 1} workers of the cluster")]
    except Exception as error:  # of a worker's own code, or of the way here: one file is lost
        if isinstance(error, TimeoutError) and future.client.status == "running":
            raise _Anew(slow) from error
        if isinstance(error, (TimeoutError, CancelledError)):
            raise SchedulerFailed(f"the scheduler at {address} is gone: {_AGAIN}") from error
        return [lost(name, f"{type(error).__name__}: {error}")]
    if kind == "unseen":
        raise SchedulerFailed(str(told))
    if kind == "full":
        raise DiskFull(str(told))
    if kind == "failed":
        return [lost(name, str(told))]
    for part in sorted(parts, key=lambda part: part.endswith(ENDING)):  # the state speaks of the others
        file = setup.out / RESULTS / part
        write_beside(file, parts[part])
        if file.suffix != ENDING:
            write_piece(file, ())
    if kind == "unfinished":
        return None
    records: list[Record] = told
    return records


# --- in a worker

_ALONE = threading.Lock()
"""A worker may have several threads; solvers and the working directory are for one at a time."""

_DIAGNOSERS: dict[str, tuple[Diagnoser, tempfile.TemporaryDirectory[str]]] = {}


def diagnose(work: bytes, name: str, stamped: Stamp, folder: str, begun: bytes | None, span_s: float) -> Task:
    """Diagnose one file, in a worker.

    Args:
        work: the setup and the observers' digest, pickled.
        name: of the file, as it is called in the results.
        stamped: its size and time, where the run is.
        folder: to which the name is relative.
        begun: its state, if it is to be gone on with.
        span_s: for so long; then it comes back with its state.
    """
    with _ALONE:
        path = Path(folder, name)
        if stamp(str(path)) != stamped:
            why = "sees another file" if path.exists() else "does not see the file"
            return "unseen", f"worker {socket.gethostname()} {why} {path}: {_SAME}", {}
        before = os.getcwd()
        try:
            os.chdir(folder if os.path.isdir(folder) else before)
            diagnoser, parts = _diagnoser(work)
            if begun is not None:
                (parts / state_file(parts, name).name).write_bytes(begun)
            kind, told = told_of(diagnoser, name, span_s)
            endings = {".parquet"} if kind != "unfinished" else {".parquet", ENDING}
            found = {part.name: part.read_bytes() for part in parts.iterdir() if part.suffix in endings}
            for part in parts.iterdir():
                part.unlink()
            return kind, told, found
        except _Unseen as error:
            return "unseen", str(error), {}
        except OSError as error:
            if error.errno in FULL:
                return "full", f"worker {socket.gethostname()}: {error}", {}
            raise
        finally:
            os.chdir(before)


_SAME = "mount it there under the same path"


class _Unseen(Exception):
    """The worker lacks a file."""


def _diagnoser(work: bytes) -> tuple[Diagnoser, Path]:
    """Return the diagnoser of a run, made once, and the folder that it writes to."""
    key = hashlib.sha256(work).hexdigest()
    if key not in _DIAGNOSERS:
        while _DIAGNOSERS:  # of another run
            _, (old, its_folder) = _DIAGNOSERS.popitem()
            old.close()
            its_folder.cleanup()
        setup, expected = pickle.loads(work)
        if setup.observers is not None and (
            not setup.observers.is_file() or digest(setup.observers) != expected
        ):
            raise _Unseen(
                f"worker {socket.gethostname()} does not see {setup.observers}, or another: {_SAME}"
            )
        own = tempfile.TemporaryDirectory(prefix="robomend-batch-")
        (Path(own.name) / RESULTS).mkdir()
        _DIAGNOSERS[key] = Diagnoser(replace(setup, out=Path(own.name))), own
    diagnoser, own = _DIAGNOSERS[key]
    return diagnoser, Path(own.name) / RESULTS
