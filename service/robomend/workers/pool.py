"""Warm, killable processes for planner and solver calls.

    run(function, *arguments, timeout_s=…)  ──►  an idle worker, or the spare, or a new one  ──►  the result
                                                      │ deadline, cancel, death
                                                      └──► killed with all that it started, and replaced

Planners and solvers ignore deadlines, hold the interpreter's lock, exhaust memory and crash; a process can
be killed, and takes nobody with it. Starting one takes seconds (imports), so workers are kept: the pool
starts them lazily, up to `size` at work, keeps `spare` more ready once it is in use, and ends those that
idle.

One worker process and how it ends with its parent: robomend.workers.process.
"""

from __future__ import annotations

import asyncio
import pickle
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType
from typing import Any, TypeVar, TypeVarTuple

from robomend.errors import Overloaded, WorkerDied, WorkerNotReady, WorkerTimeout
from robomend.workers.process import ERROR, OUT_OF_TIME, WorkerProcess

T = TypeVar("T")
Ts = TypeVarTuple("Ts")
START_TIMEOUT_S = 60.0
"""Of a worker's start, without what others kept the processor from it."""


class WorkerPool:
    """Worker processes of one kind. Thread-safe; `run` is for asyncio, `call` for everybody else.

    Args:
        name: what messages call it.
        size: how many calls may run at the same time.
        spare: how many workers are kept ready beyond those at work, once the pool is in use.
        warm: called without arguments in each new worker before it is ready: imports, parsing.
        memory_bytes: address space of a worker; None: no limit.
        idle_s: an idle worker ends after this long.
        queue_limit: how many calls may wait for a worker; more are refused with Overloaded.
        niceness: of its processes. What may be asked for by whoever can ask keeps behind the service; what a
            robot waits for has to get its share of a busy computer.
    """

    def __init__(
        self,
        name: str,
        *,
        size: int = 1,
        spare: int = 1,
        warm: Callable[[], object] | None = None,
        memory_bytes: int | None = None,
        idle_s: float = 300.0,
        queue_limit: int = 64,
        niceness: int = 0,
    ) -> None:
        if size < 1 or spare < 0:
            raise ValueError("a pool needs at least one worker, and no negative number of spares")
        self.name = name
        self._size = size
        self._spare = spare
        self._start_with = pickle.dumps((warm, memory_bytes))
        self._idle_s = idle_s
        self._queue_limit = queue_limit
        self._niceness = niceness
        self._condition = threading.Condition()
        self._idle: deque[WorkerProcess] = deque()  # the latest used on the right
        self._busy: set[WorkerProcess] = set()
        self._starting = 0
        self._starts = 0  # begun in all
        self._failed: tuple[int, BaseException] | None = None  # the latest start that failed, by its number
        self._waiting = 0
        self._calls = 0
        self._closed = False
        self._newborn: WorkerProcess | None = None
        # One thread starts every worker and lives until close(): the parent-death signal is tied to it.
        self._starter = ThreadPoolExecutor(1, thread_name_prefix=f"{name}-starter")
        self._callers = ThreadPoolExecutor(size + queue_limit, thread_name_prefix=f"{name}-call")
        self._reaper: threading.Timer | None = None

    # --- for callers ----------------------------------------------------------------------------

    def start(self) -> None:
        """Begin to start workers now, so that the next call finds one ready. Does not wait.

        Who calls it again within `idle_s` keeps one ready.
        """
        with self._condition:
            self._calls = max(self._calls, 1)
            if self._idle:
                self._idle[-1].idle_since = time.monotonic()
            self._top_up(at_least=0 if self._busy else 1)

    async def run(
        self,
        function: Callable[[*Ts], T],
        *args: *Ts,
        timeout_s: float | None = None,
        processor_s: float | None = None,
    ) -> T:
        """Return function(*args), computed in a worker.

        The deadline counts from when a worker takes the call. Cancelling the task kills the worker.

        Args:
            timeout_s: by the clock.
            processor_s: of the worker's own processor time, without that of processes that it starts.

        Raises:
            WorkerTimeout: the deadline passed; the worker was killed.
            WorkerNotReady: none was, in time.
            WorkerDied: the worker ended in the middle of the call.
            Overloaded: too many calls wait already.
            Exception: whatever the function raised.
        """
        self._admit()
        ticket = _Ticket()
        try:
            call = self._callers.submit(self._call, ticket, function, args, timeout_s, processor_s)
        except RuntimeError as error:
            self._admitted()
            raise WorkerDied(f"{self.name}: the worker pool is closed") from error
        # A call that is cancelled before a thread takes it up never comes to _call.
        call.add_done_callback(lambda one: self._admitted() if one.cancelled() else None)
        try:
            return await asyncio.wrap_future(call)
        except asyncio.CancelledError:
            ticket.cancel(self._condition)
            raise

    def call(
        self,
        function: Callable[[*Ts], T],
        *args: *Ts,
        timeout_s: float | None = None,
        processor_s: float | None = None,
    ) -> T:
        """Like `run`, for code without an event loop: blocks the calling thread."""
        self._admit()
        return self._call(_Ticket(), function, args, timeout_s, processor_s)

    def close(self) -> None:
        """Kill every worker and wait until they are gone. Calls that run end with WorkerDied."""
        with self._condition:
            self._closed = True
            if self._reaper is not None:
                self._reaper.cancel()
            workers = [*self._idle, *self._busy]
            if self._newborn is not None:
                workers.append(self._newborn)
            self._idle.clear()
            self._condition.notify_all()
        for worker in workers:
            worker.kill()
        self._starter.shutdown(wait=True, cancel_futures=True)
        self._callers.shutdown(wait=True, cancel_futures=True)

    async def aclose(self) -> None:
        """Like `close`, without blocking the event loop."""
        await asyncio.to_thread(self.close)

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def pids(self) -> tuple[int, ...]:
        """The process ids of the workers that are ready or at work."""
        with self._condition:
            return tuple(worker.pid for worker in (*self._idle, *self._busy))

    # --- within ---------------------------------------------------------------------------------

    def _call(
        self,
        ticket: _Ticket,
        function: Callable[..., T],
        args: tuple[Any, ...],
        timeout_s: float | None,
        processor_s: float | None,
    ) -> T:
        try:
            request = pickle.dumps((function, args, processor_s))
            worker = self._take(ticket)
        except BaseException:
            self._admitted()
            raise
        healthy = False
        try:
            kind, value = worker.ask(request, timeout_s)
            healthy = not isinstance(value, MemoryError)
        except TimeoutError:
            raise WorkerTimeout(
                f"{self.name}: no answer within {timeout_s:g} s; the call was ended"
            ) from None
        except (EOFError, OSError, pickle.UnpicklingError) as error:
            why = worker.ending()
            if processor_s is not None and why == f"killed by {OUT_OF_TIME.name}":
                raise WorkerTimeout(
                    f"{self.name}: no answer within {processor_s:g} s of processor time; the call was ended"
                ) from None
            raise WorkerDied(
                f"{self.name}: the worker process ended in the middle of a call ({why})"
            ) from error
        finally:
            self._give_back(ticket, worker, healthy)
        if kind == ERROR:
            if isinstance(value, MemoryError):
                raise WorkerDied(
                    f"{self.name}: the call needed more memory than a worker may have"
                ) from value
            raise value
        result: T = value
        return result

    def _admit(self) -> None:
        """Count one more call that waits for a worker."""
        with self._condition:
            if self._waiting >= self._queue_limit + self._size - len(self._busy):
                raise Overloaded(
                    f"{self.name}: {self._waiting} calls wait for a worker already; try again later"
                )
            self._waiting += 1

    def _admitted(self) -> None:
        """It does not wait any more, without a worker."""
        with self._condition:
            self._waiting -= 1

    def _take(self, ticket: _Ticket) -> WorkerProcess:
        with self._condition:
            self._calls += 1
            before = self._starts  # that one of these fails is no news: another may succeed
            while True:
                if self._closed:
                    raise WorkerDied(f"{self.name}: the worker pool is closed")
                if ticket.cancelled:
                    raise WorkerDied(f"{self.name}: the call was cancelled")
                if len(self._busy) < self._size:
                    while self._idle:
                        worker = self._idle.pop()
                        if worker.alive():
                            self._busy.add(worker)
                            self._waiting -= 1  # at the same moment, or it would count twice
                            ticket.worker = worker
                            self._top_up()
                            return worker
                        worker.kill()
                    if self._failed is not None and self._failed[0] > before:
                        error = self._failed[1]
                        if isinstance(error, WorkerNotReady):
                            raise WorkerNotReady(f"{self.name}: {error}") from error
                        raise WorkerDied(f"{self.name}: no worker could be started: {error}") from error
                    self._top_up(at_least=1)
                    if self._failed is not None and self._failed[0] > before:
                        continue
                self._condition.wait(
                    1.0
                )  # a start ends, in time or not; those that work end with their calls

    def _give_back(self, ticket: _Ticket, worker: WorkerProcess, healthy: bool) -> None:
        with self._condition:
            ticket.worker = None
            self._busy.discard(worker)
            kept = healthy and not ticket.cancelled and not self._closed
            if kept:
                worker.idle_since = time.monotonic()
                self._idle.append(worker)
                self._watch_idle()
            self._top_up()
            self._condition.notify()
        if not kept:
            worker.kill()

    def _top_up(self, at_least: int = 0) -> None:
        """Start what is missing; the condition is held."""
        if self._closed or not self._calls:
            return
        wanted = max(self._spare, at_least) - len(self._idle) - self._starting
        room = self._size + self._spare - len(self._busy) - len(self._idle) - self._starting
        for _ in range(min(wanted, room)):
            self._starting += 1
            self._starts += 1
            try:
                self._starter.submit(self._start_one, self._starts)
            except (RuntimeError, MemoryError) as error:  # no room for another thread (`ulimit -v`)
                self._starting -= 1
                self._failed = self._starts, error
                return

    def _start_one(self, number: int) -> None:
        worker: WorkerProcess | None = None
        error: BaseException | None = None
        try:
            worker = WorkerProcess(self._start_with, self._niceness)
            with self._condition:
                self._newborn = worker
                closed = self._closed
            if closed:
                worker.kill()
            worker.wait_ready(START_TIMEOUT_S)
        except Exception as reason:  # noqa: BLE001  # whatever it is, a caller waits for it
            error = reason
            if worker is not None:
                worker.kill()
        with self._condition:
            self._newborn = None
            self._starting -= 1
            if error is not None:
                self._failed = number, error
            elif worker is not None and not self._closed:
                self._idle.appendleft(worker)
                self._watch_idle()
                worker = None
            self._condition.notify_all()
        if worker is not None:
            worker.kill()

    def _watch_idle(self) -> None:
        """See to it that idle workers end; the condition is held."""
        if self._reaper is None and not self._closed:
            self._reaper = threading.Timer(self._idle_s, self._end_idle)
            self._reaper.daemon = True
            try:
                self._reaper.start()
            except (RuntimeError, MemoryError):  # no room for another thread: they stay for now
                self._reaper = None

    def _end_idle(self) -> None:
        with self._condition:
            self._reaper = None
            limit = time.monotonic() - self._idle_s
            old = [worker for worker in self._idle if worker.idle_since <= limit]
            for worker in old:
                self._idle.remove(worker)
            if not self._busy and not self._idle:
                self._calls = 0  # out of use: no spare until the next call
            elif self._idle:
                self._watch_idle()
        for worker in old:
            worker.kill()


class _Ticket:
    """One call: lets a cancelled task find its worker."""

    def __init__(self) -> None:
        self.cancelled = False
        self.worker: WorkerProcess | None = None

    def cancel(self, condition: threading.Condition) -> None:
        with condition:
            self.cancelled = True
            worker = self.worker
            condition.notify_all()
        if worker is not None:  # it does not go back among the idle ones: see _give_back
            worker.kill()
