"""Two ways to compare faults, behind one face: by signatures where these are exact, by search elsewhere."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import combinations
from typing import Protocol

from robomend.diagnosis.isolability.definite import Definite, Signatures
from robomend.diagnosis.oracle import Deadline, Oracle
from robomend.model.cnf import HealthCnf

# --- is there an observation that some faults can show, and others do not explain? Exact, for every model.
#
# "Others do not explain it" speaks of all values of what is hidden, so the question has two quantifiers:
#
#     ∃ o:  SD with F abnormal allows o   and   ∀ hidden values:  SD with G abnormal forbids o
#
# Counterexample-guided abstraction refinement answers it with two SAT solvers:
#
#     proposer: an o that F shows ──► checker: does G explain o?  no ──► found
#             ▲                             │ yes, with these hidden values h
#             └── o must break some clause ◄┘
#                 of SD under G and h
#
# What a counterexample forbids depends on G alone, so that it is kept for every further F. Hidden values
# are finitely many, so it ends; where all atoms are observed, after one refinement.
#
# Source: M. Janota, J. Marques-Silva. Abstraction-based algorithm for 2QBF. SAT 2011.

FaultSet = frozenset[int]
"""Health variables of abnormal components."""

HEALTHY: FaultSet = frozenset()


class ObservationSearch:
    """Searches observations over some variables of one model. One call at a time."""

    def __init__(self, cnf: HealthCnf, observed: Iterable[int], clock: Deadline) -> None:
        self.observed = tuple(sorted(observed))
        self._cnf = cnf
        self._count = len(cnf.components)
        self._clock = clock
        self._free = frozenset(self.observed)
        self._checker = Oracle(cnf.clauses, clock)
        # Two copies of SD that share what is observed: two faults may have to show the same.
        self._shift = cnf.variables
        copy = [[self._second(literal) for literal in clause] for clause in cnf.clauses]
        self._proposer = Oracle([*cnf.clauses, *copy], clock)
        self._top = 2 * cnf.variables
        self._guards: dict[FaultSet, int] = {}
        self._broken: dict[tuple[int, ...], int] = {}

    def find(self, showing: Sequence[FaultSet], excluding: Collection[FaultSet]) -> tuple[int, ...] | None:
        """Return an observation, as signed variables, that each fault of `showing` (at most two) can show and
        none of `excluding` explains; None: there is no such.

        Raises:
            OutOfTime: the clock ran out.
        """
        first, second = showing[0], showing[-1]
        assumptions = [
            *self._health(first),
            *(self._second(literal) for literal in self._health(second)),
            *(self._guard(fault) for fault in excluding),
        ]
        while True:
            if not self._proposer.sat(assumptions):
                return None
            model = self._proposer.model()
            seen = tuple(v if v <= len(model) and model[v - 1] > 0 else -v for v in self.observed)
            explained = False
            for fault in excluding:
                values = self._explanation(fault, seen)
                if values is not None:
                    self._refine(fault, values)
                    explained = True
            if not explained:
                return seen

    def explains(self, fault: FaultSet, seen: Sequence[int]) -> bool:
        """Return whether a fault may show an observation."""
        return self._checker.sat([*self._health(fault), *seen])

    def close(self) -> None:
        """Free the solvers."""
        self._checker.close()
        self._proposer.close()

    def _explanation(self, fault: FaultSet, seen: Sequence[int]) -> list[int] | None:
        if not self.explains(fault, seen):
            return None
        return list(self._checker.model())

    def _refine(self, fault: FaultSet, model: Sequence[int]) -> None:
        """Forbid what these hidden values explain: some clause that they leave open is broken."""
        choices = []
        for clause in self._cnf.clauses:
            rest = []
            for literal in clause:
                variable = abs(literal)
                if variable in self._free:
                    rest.append(literal)
                elif (model[variable - 1] > 0) == (literal > 0):
                    break
            else:
                choices.append(self._breaking(tuple(sorted(rest))))
        self._proposer.add([-self._guard(fault), *choices])

    def _breaking(self, rest: tuple[int, ...]) -> int:
        """Return a variable that, being true, says that none of these literals is seen."""
        found = self._broken.get(rest)
        if found is None:
            found = self._broken[rest] = self._fresh()
            for literal in rest:
                self._proposer.add([-found, -literal])
        return found

    def _guard(self, fault: FaultSet) -> int:
        found = self._guards.get(fault)
        if found is None:
            found = self._guards[fault] = self._fresh()
        return found

    def _fresh(self) -> int:
        self._top += 1
        return self._top

    def _health(self, fault: FaultSet) -> list[int]:
        return [-variable if variable in fault else variable for variable in range(1, self._count + 1)]

    def _second(self, literal: int) -> int:
        if abs(literal) in self._free:
            return literal
        return literal + self._shift if literal > 0 else literal - self._shift


Fault = tuple[int, ...]
"""Health variables of the components that are abnormal together: one, or two, ascending."""

WITNESSES = 256
"""Observations that are kept, so that one search answers for many pairs."""


class Comparison(Protocol):
    """Compares the faults of one model by what some observed variables can show."""

    def shows(self, fault: Fault) -> bool:
        """Whether the fault is detectable."""
        ...

    def told(self, fault: Fault, rival: Fault) -> bool:
        """Whether the fault can be told from the rival."""
        ...

    def always(self, fault: Fault, rival: Fault) -> bool:
        """Whether a detectable fault is told from the rival whenever it is seen. Single faults only."""
        ...

    def relevant(self, fault: Fault) -> frozenset[int]:
        """Return the atoms' variables that may tell the fault from others if they were observed, too."""
        ...

    def observing(self, more: Iterable[int]) -> Comparison:
        """Return the comparison with further variables observed."""
        ...

    def close(self) -> None:
        """Free the solvers."""
        ...


def comparison(cnf: HealthCnf, observed: Iterable[int], clock: Deadline) -> Comparison:
    """Return the comparison that suits the model."""
    definite = Definite.of(cnf)
    if definite is not None:
        return BySignatures(cnf, definite, frozenset(observed), clock)
    return BySearch(cnf, frozenset(observed), clock)


class BySignatures:
    """See robomend.diagnosis.isolability.definite."""

    def __init__(self, cnf: HealthCnf, definite: Definite, observed: frozenset[int], clock: Deadline) -> None:
        self._cnf = cnf
        self._definite = definite
        self._clock = clock
        self._signatures = Signatures(definite, observed)

    def shows(self, fault: Fault) -> bool:
        self._clock.check()
        return self._signatures.shown(fault)

    def told(self, fault: Fault, rival: Fault) -> bool:
        self._clock.check()
        return self._signatures.shown(fault, rival)

    def always(self, fault: Fault, rival: Fault) -> bool:
        (one,), (other,) = fault, rival
        return self._signatures.of(one).isdisjoint(self._signatures.of(other))

    def relevant(self, fault: Fault) -> frozenset[int]:
        found = frozenset().union(*(self._signatures.relevant(component) for component in fault))
        return found & frozenset(self._cnf.atom_variable.values())

    def observing(self, more: Iterable[int]) -> BySignatures:
        observed = self._signatures.observed.union(more)
        return BySignatures(self._cnf, self._definite, observed, self._clock)

    def close(self) -> None:
        """There is nothing to free."""


class BySearch:
    """See robomend.diagnosis.isolability.comparing. What was found for one pair is tried on the next."""

    def __init__(self, cnf: HealthCnf, observed: frozenset[int], clock: Deadline) -> None:
        self._cnf = cnf
        self._clock = clock
        self._observed = observed
        self._search = ObservationSearch(cnf, observed, clock)
        self._seen: dict[tuple[int, ...], dict[frozenset[int], bool]] = {}

    def shows(self, fault: Fault) -> bool:
        return self._shown((fault,), _smaller(fault))

    def told(self, fault: Fault, rival: Fault) -> bool:
        return self._shown((fault,), {*_smaller(fault), frozenset(rival)})

    def always(self, fault: Fault, rival: Fault) -> bool:
        return not self._shown((fault, rival), {HEALTHY})

    def relevant(self, fault: Fault) -> frozenset[int]:
        return frozenset(self._cnf.atom_variable.values()) - self._observed

    def observing(self, more: Iterable[int]) -> BySearch:
        return BySearch(self._cnf, self._observed.union(more), self._clock)

    def close(self) -> None:
        self._search.close()

    def _shown(self, showing: tuple[Fault, ...], excluding: set[frozenset[int]]) -> bool:
        sets = [frozenset(fault) for fault in showing]
        for seen in self._seen:
            if all(self._explains(fault, seen) for fault in sets) and not any(
                self._explains(fault, seen) for fault in excluding
            ):
                return True
        found = self._search.find(sets, excluding)
        if found is None:
            return False
        if len(self._seen) < WITNESSES:
            self._seen[found] = {}
        return True

    def _explains(self, fault: frozenset[int], seen: tuple[int, ...]) -> bool:
        known = self._seen[seen]
        if fault not in known:
            known[fault] = self._search.explains(fault, seen)
        return known[fault]


def _smaller(fault: Fault) -> set[frozenset[int]]:
    """Return the proper subsets of a fault: what explains as much with less."""
    return {frozenset(some) for size in range(len(fault)) for some in combinations(fault, size)}


def pairs(components: Iterable[int]) -> Iterator[Fault]:
    """Yield the double faults of some components."""
    yield from combinations(sorted(components), 2)
