"""SD in one persistent solver, and what every search asks of it.

The solver holds the clauses of the model; observations, health and what is supposed come as assumptions.
What a question adds besides, diagnoses that are blocked, is guarded and dropped afterwards; when such
leftovers have grown, the solver is built anew.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property

from robomend.diagnosis.masks import mask_of, outside
from robomend.diagnosis.oracle import Deadline, Oracle
from robomend.diagnosis.search import Bad
from robomend.model.clauses import UNKNOWN_MODE
from robomend.model.cnf import HealthCnf

LEFTOVER_CLAUSES = 20_000
"""Retired clauses that are tolerated before the solver is built anew."""


class Consistency:
    """See the module."""

    def __init__(self, cnf: HealthCnf, clock: Deadline, solver: str) -> None:
        self.cnf = cnf
        self.clock = clock
        self.solver = solver
        self.health = list(range(1, len(cnf.components) + 1))
        self._guard = cnf.variables
        self._leftover = 0

    @cached_property
    def oracle(self) -> Oracle:
        """The solver; built when it is first asked."""
        return Oracle(self.cnf.clauses, self.clock, self.solver)

    def explains(self, bad: Iterable[int], assumptions: Sequence[int]) -> bool:
        """Return whether the assumptions are consistent when just these components are abnormal."""
        return self.oracle.sat([*outside(self.health, mask_of(bad)), *assumptions])

    def any_more(self, assumptions: Sequence[int], blocked: Sequence[Sequence[int]]) -> bool:
        """Return whether some diagnosis contains none of those found, whatever its size."""
        if self._leftover > LEFTOVER_CLAUSES:
            self.close()
        oracle = self.oracle
        self._guard += 1
        for diagnosis in blocked:
            oracle.add([-self._guard, *diagnosis])
        try:
            return oracle.sat([*assumptions, self._guard])
        finally:
            oracle.add([-self._guard])
            self._leftover += len(blocked)

    def modes_of(self, bad: Iterable[int], model: Sequence[int]) -> Mapping[str, str]:
        """Return a fault mode for each abnormal component that has modes; several may fit, one is told."""
        told: dict[str, str] = {}
        for variable in bad:
            component = self.cnf.components[variable - 1]
            for mode, number in self.cnf.modes.get(component, {}).items():
                if model[number - 1] > 0:
                    told[component] = mode
                    break
        return told

    def modes_behind(self, bad: Bad, assumptions: Sequence[int]) -> Mapping[str, str]:
        """Return the same for a diagnosis of which no model is at hand."""
        if not self.cnf.modes or not self.explains(bad, assumptions):
            return {}
        return self.modes_of(bad, self.oracle.model())

    def named(self, bad: Bad, modes: Mapping[str, str], assumptions: Sequence[int]) -> Mapping[str, str]:
        """Return the fault modes that are told, of all that fit together: the same ones, whoever searched.

        From the first component to the last: "unknown" only where no name fits beside those before; then of
        the names that do the one that explains most of what is assumed, and of these the first in the model.

        Args:
            modes: some that fit together, as a model has them.
        """
        settled = list(assumptions)
        unnamed = []
        for component in modes:
            unknown = self.cnf.modes[component].get(UNKNOWN_MODE)
            if unknown is None:
                continue
            if modes[component] == UNKNOWN_MODE:
                if not self.explains(bad, [*settled, -unknown]):
                    unnamed.append(component)
                    continue
                modes = self.modes_of(bad, self.oracle.model() or ())
            settled.append(-unknown)
        for component in [one for one in modes if one not in unnamed]:
            by_use = sorted(
                self.cnf.modes[component].items(),
                key=lambda one: -len(self._said_by.get(one[1], frozenset()).intersection(assumptions)),
            )
            for mode, variable in by_use:
                if mode != modes[component]:
                    if mode == UNKNOWN_MODE or not self.explains(bad, [*settled, variable]):
                        continue
                    modes = self.modes_of(bad, self.oracle.model() or ())
                settled.append(variable)
                break
        return modes

    @cached_property
    def _said_by(self) -> Mapping[int, frozenset[int]]:
        """Fault mode -> the literals that its sentences say outright."""
        modes = {variable for named in self.cnf.modes.values() for variable in named.values()}
        said: dict[int, set[int]] = defaultdict(set)
        for clause in self.cnf.clauses:
            if len(clause) == 2:
                for one, other in (clause, clause[::-1]):
                    if -one in modes:
                        said[-one].add(other)
        return {mode: frozenset(literals) for mode, literals in said.items()}

    def close(self) -> None:
        """Free the solver."""
        if "oracle" in self.__dict__:
            self.__dict__.pop("oracle").close()
        self._leftover = 0
