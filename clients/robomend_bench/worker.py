"""One contender in a process of its own: killed when it takes too long, its memory its own.

Solvers hold the GIL, ignore interrupts and crash. In a process of its own none of that reaches the other
contenders, a time-out is always kept, and the peak of the resident set belongs to the one who caused it.
"""

from __future__ import annotations

import gc
import multiprocessing
import resource
import sys
from contextlib import suppress
from math import inf
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

    def ask(self, index: int) -> tuple[Status, Answer | None, float, str]:
        """Return status, answer, seconds and a note for one question."""
        if self.refused is None and self._process is None:
            self._start()
        if self.refused is not None or self._pipe is None:
            return ("refused" if self.refused else "error"), None, 0.0, self.refused or "it did not start"
        began = perf_counter()
        try:
            self._pipe.send(index)
            if not self._pipe.poll(self._timeout_s * GRACE + 1.0):
                self._kill()
                return "timeout", None, perf_counter() - began, KILLED
            kind, content = self._pipe.recv()
        except (EOFError, OSError):
            self._kill()
            return "error", None, perf_counter() - began, "its process died"
        if kind != "answer":
            return kind, None, perf_counter() - began, content
        answer, seconds, self.peak_mib = content
        if not answer.complete or (answer.seconds is None and seconds > self._timeout_s):
            return "timeout", answer, answer.seconds or seconds, ""
        if answer.seconds is not None:
            return "ok", answer, answer.seconds, ""
        return "ok", answer, seconds / answer.calls, ""

    def _start(self) -> None:
        context: Any = multiprocessing.get_context(START_METHOD)
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, *self._arguments), daemon=True)
        self._process.start()
        theirs.close()
        kind: str = "died"
        content: Any = ""
        with suppress(EOFError, OSError):
            if self._pipe.poll(START_S):
                kind, content = self._pipe.recv()
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
        """End the process; every run must come here."""
        if self._pipe is not None and self._process is not None:
            with suppress(OSError):  # it may have died
                self._pipe.send(None)
            self._process.join(STOP_S)
        self._kill()
