"""Which part of a candidate explains a snapshot: what is not asked again of the candidates that share it.

    snapshot 1 is explained by {a}        {a, b} and {a, c} explain it, too: no question to the solver
    snapshot 2 is explained by {b}        of {a, c} it is asked

Whether OBS is consistent with the health of all others does not depend on who else is said to be abnormal, so
that whatever contains such a part explains the snapshot. A model tells the part: those of the candidate whose
clauses it breaks if they are healthy.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import cached_property

from robomend.diagnosis.masks import bits, mask_of
from robomend.diagnosis.oracle import Oracle
from robomend.model.cnf import Clause, HealthCnf

OFTEN = 8
"""Diagnoses of several components after which parts are noted: of few it is not worth it."""

MOST_MEMBERS = 4
MOST_PARTS = 1_000
"""Of a candidate whose parts are looked up, and of parts that are kept of a snapshot."""


class ExplainedParts:
    """The parts of candidates over one model; `forced` components are abnormal whatever is asked."""

    def __init__(self, cnf: HealthCnf, forced: Collection[int]) -> None:
        self.explaining = 0  # diagnoses of several components so far
        self._cnf = cnf
        self._forced = mask_of(forced)

    def of(self, abnormal: int) -> frozenset[int]:
        """Return the parts of a candidate, as masks; none where it is too large, or a single component."""
        if self.explaining < OFTEN or not 1 < abnormal.bit_count() <= MOST_MEMBERS:
            return frozenset()
        parts = [self._forced]
        for bit in bits(abnormal & ~self._forced):
            parts += [part | 1 << bit for part in parts]
        return frozenset(parts)

    def note(self, explained: set[int], abnormal: int, oracle: Oracle) -> None:
        """Add the part of a candidate that the last model needs to be abnormal."""
        if len(explained) >= MOST_PARTS:
            return
        model = oracle.model()
        needed = abnormal
        for bit in bits(abnormal & ~self._forced):
            model[bit] = bit + 1
            if all(any(model[abs(lit) - 1] == lit for lit in clause) for clause in self._clauses[bit + 1]):
                needed ^= 1 << bit
            else:
                model[bit] = -(bit + 1)
        explained.add(needed)

    @cached_property
    def _clauses(self) -> dict[int, list[Clause]]:
        """Component -> the clauses that say something where it is healthy."""
        found: dict[int, list[Clause]] = {variable: [] for variable in self._cnf.health.values()}
        for clause in self._cnf.clauses:
            for literal in clause:
                if -literal in found:
                    found[-literal].append(clause)
        return found
