"""A baseline: each minimal diagnosis is a MaxSAT solution, found by RC2 from scratch for every question.

Hard are SD, OBS and what is supposed; soft is the health of each component. A solution's falsified soft
clauses are a minimum-cardinality diagnosis; blocked together with its supersets, the next solution is the
next one in order of size. With priors as weights, ln((1 - p)/p), the order is that of probability.

Source: A. Ignatiev, A. Morgado, J. Marques-Silva. RC2: an efficient MaxSAT solver. JSAT 11, 2019.
"""

from __future__ import annotations

from typing import Any

from pysat.examples.rc2 import RC2
from pysat.formula import WCNF

from robomend.diagnosis.base import BaseEngine, costs_of_blame, refuse_order_of_probability
from robomend.diagnosis.core_guided import MinimumTooLarge
from robomend.diagnosis.observed import SignedObs, Supposed
from robomend.diagnosis.oracle import Deadline
from robomend.diagnosis.result import Options
from robomend.diagnosis.search import NoDiagnosis, SearchState
from robomend.model.cnf import HealthCnf

WEIGHT_SCALE = 10_000
"""RC2's weights are integers: this many to a nat."""


class MaxSatEngine(BaseEngine):
    """See the module. Glucose 4 may be named, but takes up to two seconds to notice an interrupt."""

    name = "maxsat"

    def __init__(self, cnf: HealthCnf, *, solver: str | None = None) -> None:
        super().__init__(cnf, solver=solver, default_solver="glucose3")

    def _refuse(self, options: Options) -> None:
        if options.order == "probability":
            refuse_order_of_probability(self.cnf, options)
            self._weights()

    def _weights(self) -> list[int]:
        """Return the price of blaming each component."""
        return [max(1, round(WEIGHT_SCALE * cost)) for cost in costs_of_blame(self.cnf)]

    def _search(self, observed: SignedObs, what_if: Supposed, options: Options, answer: SearchState) -> None:
        self._clock.check()
        free = [v for v in self._consistency.health if v not in what_if.healthy and v not in what_if.abnormal]
        weights = self._weights() if options.order == "probability" else [1] * len(self._consistency.health)
        formula = WCNF()
        formula.extend([list(clause) for clause in self.cnf.clauses])
        formula.extend([[number] for number in observed.numbers])
        formula.extend([[v] for v in what_if.healthy] + [[-v] for v in what_if.abnormal])
        formula.extend([[v] for v in free], weights=[weights[v - 1] for v in free])
        formula.nv = max(formula.nv, self.cnf.variables)
        with _TimedRC2(formula, self._clock, self.solver) as rc2, self._clock.alarm():
            self._enumerate(rc2, free, sorted(what_if.abnormal), options, answer)

    def _enumerate(
        self, rc2: RC2, free: list[int], forced: list[int], options: Options, answer: SearchState
    ) -> None:
        least: int | None = None
        by_size = options.order == "size"
        left_out = False
        while (model := rc2.compute()) is not None:
            values = set(model)
            abnormal = [variable for variable in free if variable not in values]
            bad = tuple(sorted(abnormal + forced))
            if least is None:
                least = len(bad)
            if by_size and options.minimal == "cardinality" and len(bad) > least:
                return
            if options.max_size is not None and len(bad) > options.max_size:
                if by_size:
                    raise MinimumTooLarge
                left_out = True  # in order of probability a smaller one may still come
            else:
                answer.modes[bad] = self._consistency.modes_of(bad, model)
                answer.add(bad)
            if not abnormal:
                break
            rc2.add_clause(abnormal)
        if least is None:
            raise NoDiagnosis
        if left_out:
            raise MinimumTooLarge


class _TimedRC2(RC2):  # type: ignore[misc]  # PySAT has no type information
    """RC2 whose every call of the oracle, its heuristics' too, ends at the deadline."""

    def __init__(self, formula: WCNF, clock: Deadline, solver: str) -> None:
        self._robomend_clock = clock
        super().__init__(formula, solver=solver, exhaust=True, minz=True)

    def _call_oracle(self, assumptions: Any = (), expect_interrupt: bool = False) -> bool | None:
        clock = self._robomend_clock
        clock.check()
        clock.enter(self.oracle)
        try:
            answer: bool | None = self.oracle.solve_limited(assumptions=assumptions, expect_interrupt=True)
        finally:
            clock.leave()
            self.oracle.clear_interrupt()
        if answer is None:
            clock.check()  # else a heuristic spent its budget
        return answer
