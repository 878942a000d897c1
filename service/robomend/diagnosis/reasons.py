"""Which rules a contradiction rests on.

Unit propagation by hand, from the contradictory literals, remembering the clause that forced each new
literal; at the first falsified clause the reasons are followed back. Each clause met on the way is part of
an unsatisfiable core. It takes time in proportion to what is propagated, not to the model. Where propagation
alone does not refute, a solver with one selector a rule gives the core instead; it is built at the first
need.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from functools import cached_property

from pysat.solvers import Solver

from robomend.diagnosis.oracle import Deadline
from robomend.model.cnf import HealthCnf

WATCHED_S = 8e-6
"""A clause, to be ready for the first contradiction."""

SLICES = 10
SLICE_CONFLICTS = 2_000
"""For the fallback: a refutation that takes more is reported with the rules of the core before."""


class Reasons:
    """Finds the rules behind contradictory literals of one model."""

    def __init__(self, cnf: HealthCnf, clock: Deadline) -> None:
        self._cnf = cnf
        self._clock = clock
        self._solver: Solver | None = None

    @cached_property
    def _watch(self) -> dict[int, list[int]]:
        """Literal -> the clauses that become shorter when it is true."""
        watch: dict[int, list[int]] = defaultdict(list)
        for index, clause in enumerate(self._cnf.clauses):
            for literal in clause:
                watch[-literal].append(index)
        return dict(watch)

    @property
    def prepared_in_s(self) -> float:
        """What the first call takes longer than the others."""
        return 0.0 if "_watch" in self.__dict__ else WATCHED_S * len(self._cnf.clauses)

    @cached_property
    def _units(self) -> list[int]:
        """The clauses that hold of themselves: of length one, or empty."""
        return [index for index, clause in enumerate(self._cnf.clauses) if len(clause) < 2]

    def rules(self, literals: Sequence[int]) -> tuple[int, ...]:
        """Return the rules, as indices into cnf.rules, of an unsatisfiable core of SD with these literals.

        Empty when they do not contradict SD, or when the fallback found no refutation within its budget or
        the time that is left.
        """
        used = self._by_propagation(literals)
        if used is None:
            return self._by_selectors(literals)
        origins = self._cnf.origins
        return tuple(sorted({origins[index] for index in used}))

    def _by_propagation(self, literals: Sequence[int]) -> set[int] | None:
        clauses, watch = self._cnf.clauses, self._watch
        reason: dict[int, int | None] = dict.fromkeys(literals)  # true literal -> the clause that forced it
        queue = list(reason)
        for index in self._units:
            clause = clauses[index]
            if not clause:
                return {index}
            if -clause[0] in reason:
                return self._back(index, reason)
            if clause[0] not in reason:
                reason[clause[0]] = index
                queue.append(clause[0])
        for literal in queue:  # grows while it is read
            for index in watch.get(literal, ()):
                unit = 0
                for other in clauses[index]:
                    if other in reason:
                        break
                    if -other not in reason:
                        if unit:
                            break
                        unit = other
                else:
                    if not unit:
                        return self._back(index, reason)
                    reason[unit] = index
                    queue.append(unit)
        return None

    def _back(self, falsified: int, reason: dict[int, int | None]) -> set[int]:
        clauses = self._cnf.clauses
        used = {falsified}
        todo = [falsified]
        while todo:
            for literal in clauses[todo.pop()]:
                index = reason.get(-literal)
                if index is not None and index not in used:
                    used.add(index)
                    todo.append(index)
        return used

    def _by_selectors(self, literals: Sequence[int]) -> tuple[int, ...]:
        top = self._cnf.variables
        count = len(self._cnf.rules)
        if self._solver is None:
            pairs = zip(self._cnf.clauses, self._cnf.origins, strict=True)
            self._solver = Solver(
                name="minisat22",
                bootstrap_with=([*clause, -(top + 1 + origin)] for clause, origin in pairs),
            )
        solver = self._solver
        selectors = list(range(top + 1, top + 1 + count))
        refuted = False
        while self._refutes(solver, [*literals, *selectors]):
            refuted = True
            core = [literal for literal in solver.get_core() or [] if literal > top]
            if len(core) >= len(selectors):
                break
            selectors = core
        if not refuted:
            return ()
        return tuple(sorted(selector - top - 1 for selector in selectors))

    def _refutes(self, solver: Solver, literals: list[int]) -> bool:
        """Return whether the solver refutes the literals, within its budget and the time that is left."""
        for _ in range(SLICES):
            if not self._clock.left_s:
                return False
            solver.conf_budget(SLICE_CONFLICTS)
            answer = solver.solve_limited(assumptions=literals)
            if answer is not None:
                return answer is False
        return False

    def close(self) -> None:
        """Free the fallback's solver."""
        if self._solver is not None:
            self._solver.delete()
            self._solver = None
