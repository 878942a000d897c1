"""One contender in a process of its own: killed when it takes too long, its memory its own.

Solvers hold the GIL, ignore interrupts and crash. In a process of its own none of that reaches the other
contenders, a time-out is always kept, and the peak of the resident set belongs to the one who caused it.
"""

from __future__ import annotations

import gc
import multiprocessing
import resource
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from math import inf
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

from robomend.errors import InputError, OptionRefused, RobomendError
from robomend_bench.external import prepare_external
from robomend_bench.results import KILLED, Status
from robomend_bench.suite import Answer, Ask, Group, Wish, find_suite

START_S = 300.0
"""To import, build the model and its structures."""

GRACE = 1.5
"""A contender that keeps its own time-out answers before this factor of it is over."""

STOP_S = 5.0

BROKEN_OFF_S = 1.0
"""To end the solver of somebody else that was asked. One of ours does not hear of it, and is killed."""

RUN_UP_S = 0.005
"""A first question that takes less is answered again before each one that counts. While the process slept,
others filled the processor's caches, and to fill them anew takes longer than a question of 0.1 ms."""

START_METHOD = "spawn"
"""A fresh interpreter: nothing of ours in its memory, whatever ran before."""


def peak_mib() -> float:
    """Return the highest resident set of this process so far.

    Linux hands the peak of getrusage on through exec, so that a child would start with its parent's; VmHWM
    belongs to the memory itself.
    """
    with suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1 << 20 if sys.platform == "darwin" else 1 << 10)


def _serve(pipe: Connection, suite: str, contender: str, group: Group, wish: Wish) -> None:
    """Answer questions by index until None comes."""
    signal.signal(
        signal.SIGTERM, lambda *_: sys.exit(1)
    )  # by way of `finally`: a solver of others ends with us
    ask: Ask
    clock = process_time if wish.clock == "cpu" else perf_counter
    began, before = clock(), peak_mib()
    try:
        others = {external.name: external for external in wish.external}
        if contender in others:
            ask = prepare_external(others[contender], find_suite(suite), group, wish)
        else:
            ask = find_suite(suite).prepare(contender, group, wish)
    except InputError as error:
        pipe.send(("refused", str(error)))
        return
    pipe.send(("ready", (clock() - began, before, peak_mib())))
    gc.collect()
    gc.freeze()  # what was built to be kept is not gone through at each collection
    first_took = inf
    while (index := pipe.recv()) is not None:
        if first_took < RUN_UP_S:
            ask(group.questions[0])
        began = clock()
        try:
            answer = ask(group.questions[index])
        except OptionRefused as error:
            pipe.send(("refused", str(error)))
            continue
        except (RobomendError, RuntimeError, ValueError, MemoryError) as error:
            pipe.send(("error", f"{type(error).__name__}: {error}"))
            continue
        took = clock() - began
        if index == 0:
            first_took = took
        pipe.send(("answer", (answer, took, peak_mib())))


@contextmanager
def _without_ctrl_c() -> Iterator[None]:
    """What is started meanwhile hears nothing of Ctrl-C: the run ends it, which hears of it afterwards."""
    resource_tracker.ensure_running()  # the first process that is started lets signals through again
    came: list[int] = []
    ours = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, lambda number, _: came.append(number)) if ours else None
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # which they start with
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if ours:
            signal.signal(signal.SIGINT, handler)
        if came:
            raise KeyboardInterrupt


class Contestant:
    """The parent's side of one contender for one group. Starts again after a time-out."""

    def __init__(self, suite: str, contender: str, group: Group, wish: Wish) -> None:
        self.name = contender
        self.build_s: float | None = None
        self.base_mib = 0.0  # before the model was built
        self.peak_mib = 0.0
        self.refused: str | None = None
        self._arguments = (suite, contender, group, wish)
        self._timeout_s = wish.timeout_s
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None
        self._busy = False  # it was asked something, and has not answered

    def ask(self, index: int) -> tuple[Status, Answer | None, float, str]:
        """Return status, answer, seconds and a note for one question."""
        if self.refused is None and self._process is None:
            self._start()
        if self.refused is not None or self._pipe is None:
            return ("refused" if self.refused else "error"), None, 0.0, self.refused or "it did not start"
        began = perf_counter()
        self._busy = True
        try:
            self._pipe.send(index)
            if not self._pipe.poll(self._timeout_s * GRACE + 1.0):
                self._kill()
                return "timeout", None, perf_counter() - began, KILLED
            kind, content = self._pipe.recv()
        except (EOFError, OSError):
            self._kill()
            return "error", None, perf_counter() - began, "its process died"
        self._busy = False
        if kind != "answer":
            return kind, None, perf_counter() - began, content
        answer, seconds, self.peak_mib = content
        if not answer.complete or (answer.seconds is None and seconds > self._timeout_s):
            return "timeout", answer, answer.seconds or seconds, answer.note
        if answer.seconds is not None:
            return "ok", answer, answer.seconds, ""
        return "ok", answer, seconds / answer.calls, ""

    def _start(self) -> None:
        context: Any = multiprocessing.get_context(START_METHOD)
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, *self._arguments), daemon=True)
        self._busy = True
        with _without_ctrl_c():
            self._process.start()
        theirs.close()
        kind: str = "died"
        content: Any = ""
        with suppress(EOFError, OSError):
            if self._pipe.poll(START_S):
                kind, content = self._pipe.recv()
        self._busy = False
        if kind == "ready":
            self.build_s, self.base_mib, self.peak_mib = content
            return
        self._kill()
        if kind == "refused":
            self.refused = content

    def _kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join(STOP_S)
        if self._pipe is not None:
            self._pipe.close()
        self._process = self._pipe = None

    def close(self) -> None:
        """End the process, in the middle of a question too; every run must come here."""
        if self._pipe is not None and self._process is not None:
            if self._busy:
                self._process.terminate()
                self._process.join(BROKEN_OFF_S)
            else:
                with suppress(OSError):  # it may have died
                    self._pipe.send(None)
                self._process.join(STOP_S)
        self._kill()
