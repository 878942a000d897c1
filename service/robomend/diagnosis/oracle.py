"""One persistent SAT solver: clauses once, then questions under assumptions, with a deadline that is kept.

    ask(assumptions) ── small budget of conflicts ──► answer (nearly always)
                                 │ spent
                                 ▼
                     GIL released, alarm set ──► answer, or OutOfTime

Most questions take microseconds, where a thread for the alarm would cost more than the search, so a question
starts with a budget that bounds it to some milliseconds. Only one that outlives it is asked again with the
GIL released and a timer that interrupts the solver at the deadline; learnt clauses keep what the first try
found out.

Only solvers that take assumptions *and* can be interrupted are admitted: kissat ignores assumptions (and
answers wrongly), the CaDiCaL family never releases the GIL and ignores interrupts, and others have no
budgets.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from math import inf
from time import perf_counter, thread_time
from typing import Any

import pysolvers
from pysat.solvers import Solver, SolverNames

from robomend.errors import OptionRefused

INTERRUPTIBLE = (
    "minisat22",
    "minisatgh",
    "minicard",
    "glucose3",
    "glucose4",
    "glucose42",
    "gluecard3",
    "gluecard4",
    "maplesat",
    "maplecm",
    "maplechrono",
)

WHY_NOT = {
    "kissat404": "it ignores assumptions and would answer wrongly",
    "cadical103": "it cannot be interrupted",
    "cadical153": "it cannot be interrupted",
    "cadical195": "it cannot be interrupted",
    "cadical300": "it cannot be interrupted",
    "lingeling": "it has no budgets and cannot be interrupted",
    "minisatep": "its extra preprocessing is not safe under assumptions",
}

SHORT_CONFLICTS = 500
SHORT_PROPAGATIONS = 2_000_000


class OutOfTime(Exception):
    """The deadline passed, or someone called interrupt."""


def solver_name(name: str | None, default: str = "minisat22") -> str:
    """Return the canonical name of a PySAT solver that the engines can use.

    Raises:
        OptionRefused: unknown, ignores assumptions, or cannot be interrupted.
    """
    if name is None:
        return default
    for canonical in dir(SolverNames):
        names = getattr(SolverNames, canonical)
        if isinstance(names, tuple) and (name in names or name == canonical):
            if canonical in INTERRUPTIBLE:
                return canonical if canonical in names else str(names[-1])
            why = WHY_NOT.get(canonical, "it has no budgets or cannot be interrupted")
            raise OptionRefused(f"solver {name!r}: {why}; choose one of {', '.join(INTERRUPTIBLE)}")
    raise OptionRefused(f"no solver is named {name!r}; choose one of {', '.join(INTERRUPTIBLE)}")


class Deadline:
    """The deadline and the stop button of one engine, shared by its oracles."""

    def __init__(self) -> None:
        self.deadline: float | None = None
        self.stopped = False
        self.worked_until_s: float | None = None  # the thread's own time, of a part of the work
        self.running: Any = None  # the solver inside a long call
        self._whole: float | None = None  # the deadline before anything was reserved
        self._lock = threading.Lock()

    def start(self, timeout_s: float | None) -> None:
        """Begin a call; forgets an interrupt that came while nothing ran."""
        with self._lock:
            self.stopped = False
            self.deadline = self._whole = None if timeout_s is None else perf_counter() + timeout_s

    def reserve(self, seconds: float) -> None:
        """Keep so much of the time for what comes after the search, instead of what was kept before.

        Raises:
            OutOfTime: no more than that is left.
        """
        if self._whole is not None:
            self.deadline = self._whole - seconds
        self.check()

    def reserve_more(self, seconds: float) -> None:
        """Keep so much besides what was kept before.

        Raises:
            OutOfTime: no more than that is left.
        """
        if self.deadline is not None:
            self.deadline -= seconds
        self.check()

    @contextmanager
    def at_most(self, seconds: float) -> Iterator[None]:
        """End what is inside after so many seconds of this thread's own work, by OutOfTime.

        By the clock a busy computer would end it before it has begun.
        """
        self.worked_until_s = thread_time() + seconds
        try:
            yield
        finally:
            self.worked_until_s = None

    @property
    def left_s(self) -> float:
        """The time that is left: before something that cannot be interrupted."""
        if self.stopped:
            return 0.0
        return inf if self.deadline is None else max(0.0, self.deadline - perf_counter())

    def stop(self) -> None:
        """Stop the running call soon, from any thread."""
        with self._lock:
            self.stopped = True
            if self.running is not None:
                self.running.interrupt()

    @contextmanager
    def alarm(self) -> Iterator[None]:
        """Interrupt the long calls inside at the deadline; those that begin later are refused by `check`."""
        if self.deadline is None:
            yield
            return
        timer = threading.Timer(max(0.0, self.deadline - perf_counter()), self._expire)
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()

    def _expire(self) -> None:
        """Interrupt the long call if its time is up; an alarm that comes late hits nobody else's."""
        with self._lock:
            if self.running is not None and self.deadline is not None and perf_counter() >= self.deadline:
                self.running.interrupt()

    def enter(self, solver: Any) -> None:
        """The solver is about to start a long call."""
        with self._lock:
            if self.stopped:
                raise OutOfTime
            self.running = solver

    def leave(self) -> None:
        """The long call is over."""
        with self._lock:
            self.running = None

    def check(self) -> None:
        """Raise OutOfTime when the time is up."""
        if self.stopped or (self.deadline is not None and perf_counter() >= self.deadline):
            raise OutOfTime
        if self.worked_until_s is not None and thread_time() >= self.worked_until_s:
            raise OutOfTime


class Oracle:
    """A persistent solver. `sat` answers; `core` and `model` tell of the last answer."""

    def __init__(self, clauses: Iterable[Sequence[int]], clock: Deadline, solver: str = "minisat22") -> None:
        self.name = solver
        self._clock = clock
        self._solver = Solver(name=solver, bootstrap_with=clauses)
        inner = self._solver.solver  # the facade costs a call on each question
        self._inner = inner
        self.add = inner.add_clause
        # Without the facade, which takes a third of adding a short clause. It must not outlive the solver,
        # so that nobody else is given it.
        self._add = inner.add_clause
        if solver == "minisat22":
            self._add = partial(pysolvers.minisat22_add_cl, inner.minisat)
        self.at_most = inner.add_atmost  # MiniCard-type solvers only
        self.core = inner.get_core
        self.model = inner.get_model
        self.set_phases = inner.set_phases
        self.propagate = inner.propagate
        self.variables = inner.nof_vars  # the highest that it has met

    def add_all(self, clauses: Iterable[Sequence[int]]) -> None:
        """Add clauses; nothing, like `add`, once the solver is closed."""
        deque(map(self._add, clauses), maxlen=0)

    def sat(self, assumptions: list[int]) -> bool:
        """Return whether the clauses have a model under the assumptions.

        Raises:
            OutOfTime: the deadline passed, or the clock was stopped.
        """
        answer = self.quickly(assumptions, SHORT_CONFLICTS, SHORT_PROPAGATIONS)
        while answer is None and self._clock.worked_until_s is not None:  # piece by piece: soon it is over
            answer = self.quickly(assumptions, SHORT_CONFLICTS, SHORT_PROPAGATIONS)
        if answer is None:
            answer = self._long(assumptions)
        return answer

    def quickly(self, assumptions: list[int], conflicts: int, propagations: int) -> bool | None:
        """Return the same, None where it takes more than that.

        Raises:
            OutOfTime: the deadline passed, or the clock was stopped.
            KeyboardInterrupt: Ctrl-C; the solver is of no use afterwards.
        """
        self._clock.check()
        inner = self._inner
        inner.conf_budget(conflicts)
        inner.prop_budget(propagations)
        try:
            answer: bool | None = inner.solve_limited(assumptions)
        except pysolvers.error as error:
            if "keyboard interrupt" in str(error):  # Ctrl-C while the solver has the processor
                raise KeyboardInterrupt from error
            raise
        return answer

    def _long(self, assumptions: list[int]) -> bool:
        clock, inner = self._clock, self._inner
        inner.conf_budget(-1)
        inner.prop_budget(-1)
        clock.enter(inner)
        try:
            with clock.alarm():
                answer: bool | None = inner.solve_limited(assumptions, expect_interrupt=True)
        finally:
            clock.leave()
            inner.clear_interrupt()
        if answer is None:
            raise OutOfTime
        return answer

    def close(self) -> None:
        """Free the solver's memory."""
        self._add = self.add  # which knows that there is no solver any more
        self._solver.delete()
