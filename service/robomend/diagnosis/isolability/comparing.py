"""Two ways to compare faults, behind one face: by signatures where these are exact, by search elsewhere."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import combinations
from typing import Protocol

from robomend.diagnosis.isolability.definite import Definite, Signatures
from robomend.diagnosis.isolability.search import HEALTHY, ObservationSearch
from robomend.diagnosis.oracle import Deadline
from robomend.model.cnf import HealthCnf

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
    """See robomend.diagnosis.isolability.search. What was found for one pair is tried on the next."""

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
