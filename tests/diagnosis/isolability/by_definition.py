"""Isolability by its definition: all assignments, all observations. Shares no code with ours."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from itertools import combinations, product

from robomend.model.cnf import HealthCnf

Seen = tuple[bool, ...]


class ByDefinition:
    """What can be seen of every fault set, over some observed variables."""

    def __init__(self, cnf: HealthCnf, observed: Iterable[int]) -> None:
        self.cnf = cnf
        self.observed = sorted(observed)

    @cached_property
    def shown(self) -> dict[frozenset[int], set[Seen]]:
        """Fault set -> Obs(F): the projections of the models in which just its components are abnormal."""
        count = len(self.cnf.components)
        found: dict[frozenset[int], set[Seen]] = {}
        for signs in product((False, True), repeat=self.cnf.variables):
            if all(any(signs[abs(x) - 1] == (x > 0) for x in clause) for clause in self.cnf.clauses):
                bad = frozenset(c for c in range(1, count + 1) if not signs[c - 1])
                found.setdefault(bad, set()).add(tuple(signs[v - 1] for v in self.observed))
        return found

    def of(self, fault: Iterable[int]) -> set[Seen]:
        return self.shown.get(frozenset(fault), set())

    def diagnosed(self, fault: Sequence[int]) -> set[Seen]:
        """Return the observations of which a fault is a minimal diagnosis."""
        less = [frozenset(some) for size in range(len(fault)) for some in combinations(fault, size)]
        return self.of(fault) - set().union(*map(self.of, less))

    def detectable(self, fault: Sequence[int]) -> bool:
        return bool(self.diagnosed(fault))

    def told(self, fault: Sequence[int], rival: Sequence[int]) -> bool:
        return bool(self.diagnosed(fault) - self.of(rival))

    def always(self, fault: Sequence[int], rival: Sequence[int]) -> bool:
        return not self.diagnosed(fault) & self.of(rival)

    def place(self, fault: Sequence[int], rival: Sequence[int]) -> str:
        """Return what the matrix has to say."""
        if fault == rival:
            return "="
        if not self.told(fault, rival):
            return "-"
        return "+" if self.always(fault, rival) else "~"


def least_cost(
    cnf: HealthCnf,
    observed: Sequence[int],
    goals: Sequence[tuple[Sequence[int], Sequence[int] | None]],
) -> float | None:
    """Return the least cost of further atoms that reach each goal that all atoms together reach."""
    atoms = {variable: atom for atom, variable in cnf.atom_variable.items()}
    left = sorted(set(atoms) - set(observed))

    def reached(goal: tuple[Sequence[int], Sequence[int] | None], by: ByDefinition) -> bool:
        fault, rival = goal
        return by.detectable(fault) if rival is None else by.told(fault, rival)

    everything = ByDefinition(cnf, [*observed, *left])
    within = [goal for goal in goals if reached(goal, everything)]
    if not within:
        return None
    best: float | None = None
    for size in range(len(left) + 1):
        for more in combinations(left, size):
            cost = sum(cnf.costs.get(atoms[variable], 1.0) for variable in more)
            if best is None or cost < best:
                by = ByDefinition(cnf, [*observed, *more])
                if all(reached(goal, by) for goal in within):
                    best = cost
    return best
