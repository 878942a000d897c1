"""What people would use instead, as they would: on the whole model, without its structure.

    rc2             RC2(wcnf): a new formula and solver each time, default options
    rc2-stratified  RC2Stratified(wcnf), the same
    rc2-exhaust     RC2(wcnf, solver="g4", exhaust=True, minz=True), the same
    layered-full    one solver for the model; a totalizer over all health literals, bound 0, 1, 2, …
    clingo-domain   one grounding; the solver prefers ¬AB, so that each answer set is subset-minimal
    marco           all minimal conflicts: seeds from a map of what is unexplored, shrunk or grown (MiniSat)
    optux           all minimal conflicts, the smallest first: OptUx of PySAT

HS-DAG, the fourth, is an engine of robomend itself (`hs_dag`). Each takes literals and returns diagnoses as
tuples of health variables; the caller counts them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any

import clingo
from pysat.card import ITotalizer
from pysat.examples.optux import OptUx
from pysat.examples.rc2 import RC2, RC2Stratified
from pysat.formula import WCNF
from pysat.solvers import Solver

from robomend.model.cnf import HealthCnf
from robomend_bench.suite import ONE
from robomend_client.literals import Literal

Diagnoses = Iterator[tuple[int, ...]]


def numbers(cnf: HealthCnf, observations: Iterable[Literal]) -> list[int]:
    """Return observations as signed variables; those that no rule mentions are left out."""
    return [number for literal in observations if (number := cnf.literal(literal)) is not None]


class Rc2:
    """A MaxSAT call an observation, formula building included, with one set of options."""

    modes = (*ONE, "all", "factored")

    def __init__(self, cnf: HealthCnf, name: str, made: Callable[[WCNF], RC2]) -> None:
        self.name = name
        self._cnf = cnf
        self._made = made

    def diagnoses(self, observations: Iterable[Literal], mode: str, max_size: int) -> Diagnoses:
        """Yield one minimum-cardinality diagnosis, or all."""
        cnf = self._cnf
        formula = WCNF()
        for clause in cnf.clauses:
            formula.append(list(clause))
        for number in numbers(cnf, observations):
            formula.append([number])
        health = range(1, len(cnf.components) + 1)
        for variable in health:
            formula.append([variable], weight=1)
        with self._made(formula) as search:
            least: int | None = None
            while (model := search.compute()) is not None:
                bad = tuple(variable for variable in health if model[variable - 1] < 0)
                if least is not None and len(bad) > least:
                    return
                least = len(bad)
                yield bad
                if mode in ONE or not bad:
                    return
                search.add_clause(list(bad))


class LayeredFull:
    """Sizes 0, 1, 2, … on one persistent solver; found diagnoses are blocked under a literal of the call."""

    name = "layered-full"
    modes = (*ONE, "all", "factored", "subset")

    def __init__(self, cnf: HealthCnf) -> None:
        self._cnf = cnf
        self._solver = Solver("minisat22", bootstrap_with=cnf.clauses)
        self._sum: ITotalizer | None = None
        self._top = cnf.variables

    def diagnoses(self, observations: Iterable[Literal], mode: str, max_size: int) -> Diagnoses:
        """Yield the minimum-cardinality diagnoses, or in mode "subset" all minimal ones up to a size."""
        seen = numbers(self._cnf, observations)
        n = len(self._cnf.components)
        self._top += 1
        call = self._top
        size, found = 0, False
        try:
            last = min(n, max_size) if mode == "subset" else n
            while size <= last and not (found and mode != "subset"):
                assumptions = [*seen, call, *self._at_most(size)]
                while self._solver.solve(assumptions):
                    model = self._solver.get_model()
                    bad = tuple(v for v in range(1, n + 1) if model[v - 1] < 0)
                    found = True
                    yield bad
                    if mode in ONE or not bad:
                        return
                    self._solver.add_clause([*bad, -call])
                size += 1
        finally:
            self._solver.add_clause([-call])

    def _at_most(self, size: int) -> list[int]:
        n = len(self._cnf.components)
        if size == 0:
            return list(range(1, n + 1))
        if size >= n:
            return []
        if self._sum is None:
            self._sum = ITotalizer([-v for v in range(1, n + 1)], ubound=size, top_id=self._top)
            fresh = self._sum.cnf.clauses
        elif self._sum.ubound < size:
            self._sum.increase(ubound=size, top_id=self._top)
            fresh = self._sum.cnf.clauses[-self._sum.nof_new :] if self._sum.nof_new else []
        else:
            fresh = []
        self._top = max(self._top, self._sum.top_id)
        for clause in fresh:
            self._solver.add_clause(clause)
        return [-self._sum.rhs[size]]


class ClingoDomain:
    """Subset-minimal answer sets by domain heuristics, on one Control; observations are assumptions.

    Only the abnormality atoms are shown: with `--dom-mod=5,16` the minimality is over the shown atoms.
    """

    name = "clingo-domain"
    modes = (*ONE, "all", "factored", "subset")

    def __init__(self, cnf: HealthCnf) -> None:
        self._cnf = cnf
        options = ["--heuristic=Domain", "--dom-mod=5,16", "--enum-mode=domRec", "--models=0"]
        self._control: Any = clingo.Control([*options, "--warn=none"])
        n = len(cnf.components)
        with self._control.backend() as backend:
            atom = [0] * (cnf.variables + 1)
            for variable in range(1, cnf.variables + 1):
                symbol = clingo.Function("ab", [clingo.Number(variable)]) if variable <= n else None
                atom[variable] = backend.add_atom(symbol) if symbol is not None else backend.add_atom()
            backend.add_rule(atom[1:], [], choice=True)
            for clause in cnf.clauses:
                # health variable v is true when v is healthy, its atom ab(v) when not: the sign turns
                body = [
                    (-atom[abs(lit)] if lit > 0 else atom[abs(lit)]) * (-1 if abs(lit) <= n else 1)
                    for lit in clause
                ]
                backend.add_rule([], body)
        self._atom = atom
        # Size -> the atom that, assumed, allows no more abnormal components.
        self._bounds: dict[int, int] = {}

    def diagnoses(self, observations: Iterable[Literal], mode: str, max_size: int) -> Diagnoses:
        """Yield subset-minimal diagnoses up to a size, unordered; in other modes those of least size."""
        assumptions = [
            self._atom[number] if number > 0 else -self._atom[-number]
            for number in numbers(self._cnf, observations)
        ]
        if mode == "subset":
            yield from self._enumerate(assumptions, max_size)
            return
        for size in range(1, len(self._cnf.components) + 1):
            least: list[tuple[int, ...]] = []
            for bad in self._enumerate(assumptions, size):
                if not least or len(bad) < len(least[0]):
                    least = [bad]
                elif len(bad) == len(least[0]):
                    least.append(bad)
                if mode in ONE and len(bad) <= 1:
                    break
            if least:
                yield from least[:1] if mode in ONE else least
                return

    def _bound(self, size: int) -> int:
        """Return the atom of a bound; rules of bounds that nobody asked for would only slow the solver."""
        if size not in self._bounds:
            n = len(self._cnf.components)
            with self._control.backend() as backend:
                bound, over = backend.add_atom(), backend.add_atom()
                backend.add_rule([bound], [], choice=True)
                weights = [(atom, 1) for atom in self._atom[1 : n + 1]]
                backend.add_weight_rule([over], size + 1, weights)
                backend.add_rule([], [bound, over])
            self._bounds[size] = bound
        return self._bounds[size]

    def _enumerate(self, assumptions: list[int], size: int) -> Diagnoses:
        wanted = self._bound(size)
        bounds = [wanted, *(-other for other in self._bounds.values() if other != wanted)]
        with self._control.solve(yield_=True, assumptions=[*assumptions, *bounds]) as handle:
            met = set()
            for model in handle:
                bad = tuple(symbol.arguments[0].number for symbol in model.symbols(atoms=True))
                if bad in met:
                    return  # all of ab is decided: clingo then drops domRec, and goes through the other atoms
                met.add(bad)
                yield bad


class Marco:
    """All minimal conflicts of the components, given SD and OBS, by the MARCO algorithm.

    Source: M. H. Liffiton, A. Previti, A. Malik, J. Marques-Silva. Fast, flexible MUS enumeration.
    Constraints 21(2), 2016.
    """

    name = "marco"
    modes = ("conflicts",)

    def __init__(self, cnf: HealthCnf) -> None:
        self._cnf = cnf
        self._solver = Solver("minisat22", bootstrap_with=cnf.clauses)

    def diagnoses(self, observations: Iterable[Literal], mode: str, max_size: int) -> Diagnoses:
        """Yield the minimal conflicts, each as the health variables that cannot all be true."""
        seen = numbers(self._cnf, observations)
        health = frozenset(range(1, len(self._cnf.components) + 1))
        with Solver("minisat22", bootstrap_with=[[v, -v] for v in health]) as unexplored:
            unexplored.set_phases(sorted(health))  # large seeds first: most of them are conflicts
            while unexplored.solve():
                seed = frozenset(v for v in unexplored.get_model() if v > 0)
                if self._solver.solve([*seen, *seed]):
                    model = self._solver.get_model()
                    grown = seed | {v for v in health if model[v - 1] > 0}
                    for variable in health - grown:
                        if self._solver.solve([*seen, *grown, variable]):
                            grown |= {variable}
                    if grown == health:
                        return
                    unexplored.add_clause(sorted(health - grown))
                    continue
                core = seed & frozenset(self._solver.get_core() or ())
                for variable in sorted(core):
                    if variable in core and not self._solver.solve([*seen, *(core - {variable})]):
                        core = core & frozenset(self._solver.get_core() or ())
                yield tuple(sorted(core))
                unexplored.add_clause([-variable for variable in sorted(core)])


class OptUxAll:
    """All minimal conflicts by PySAT's OptUx, the smallest first; a new formula each time.

    Source: A. Ignatiev, A. Previti, M. Liffiton, J. Marques-Silva. Smallest MUS extraction with minimal
    hitting set dualization. CP 2015.
    """

    name = "optux"
    modes = ("conflicts",)

    def __init__(self, cnf: HealthCnf) -> None:
        self._cnf = cnf

    def diagnoses(self, observations: Iterable[Literal], mode: str, max_size: int) -> Diagnoses:
        """Yield the minimal conflicts, each as the health variables that cannot all be true."""
        formula = WCNF()
        for clause in self._cnf.clauses:
            formula.append(list(clause))
        for number in numbers(self._cnf, observations):
            formula.append([number])
        for variable in range(1, len(self._cnf.components) + 1):
            formula.append([variable], weight=1)
        with Solver("minisat22", bootstrap_with=[*formula.hard, *formula.soft]) as all_healthy:
            if all_healthy.solve():
                return  # OptUx takes contradictions only
        with OptUx(formula, solver="m22", unsorted=False) as search:
            for core in search.enumerate():
                yield tuple(sorted(core))  # soft clauses are numbered as health variables are


Baseline = Rc2 | LayeredFull | ClingoDomain | Marco | OptUxAll

RC2_OPTIONS: dict[str, Callable[[WCNF], RC2]] = {
    "rc2": RC2,
    "rc2-stratified": RC2Stratified,
    "rc2-exhaust": partial(RC2, solver="g4", exhaust=True, minz=True),
}
"""Who wins depends on the circuit; a fair comparison is with the fastest of them."""

BASELINES: dict[str, Callable[[HealthCnf], Baseline]] = {
    **{name: partial(Rc2, name=name, made=made) for name, made in RC2_OPTIONS.items()},
    "layered-full": LayeredFull,
    "clingo-domain": ClingoDomain,
    "marco": Marco,
    "optux": OptUxAll,
}
