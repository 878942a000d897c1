"""Which conflicts are reported: minimal ones, as many as show why each member of each diagnosis is needed.

D without c is no diagnosis, so some conflict meets D in c alone. And a conflict C is minimal if for each of
its members c there is a diagnosis that meets C in c alone: then the others can be healthy together. Both are
looked up first among what the search found, and asked of the solver where that does not settle it.
"""

from __future__ import annotations

from collections.abc import Sequence

from robomend.diagnosis.conflicts import Conflicts, Known
from robomend.diagnosis.masks import bits, mask_of, outside
from robomend.diagnosis.observed import NOTHING_SUPPOSED, SignedObs, Supposed
from robomend.diagnosis.oracle import Oracle, OutOfTime
from robomend.model.cnf import HealthCnf

MAX_CONFLICTS = 100
MAX_CIRCUIT_CONFLICTS = 8
"""Reported conflicts. Those of circuits have hundreds of gates, and each costs as many solver calls."""

JUSTIFIED = 100
"""Diagnoses that are looked at when conflicts are gathered."""


class Justification:
    """The conflicts behind the diagnoses of one call, given as bit masks."""

    def __init__(
        self,
        cnf: HealthCnf,
        oracle: Oracle,
        conflicts: Conflicts,
        observed: SignedObs,
        what_if: Supposed,
        masks: Sequence[int],
    ) -> None:
        self._oracle = oracle
        self._conflicts = conflicts
        self._observed = observed
        self._what_if = what_if
        self._masks = masks
        self._most = MAX_CIRCUIT_CONFLICTS if cnf.circuit else MAX_CONFLICTS
        self._health = list(range(1, len(cnf.components) + 1))
        self._forced = mask_of(what_if.abnormal)
        self._tail = [*observed.numbers, *what_if.numbers]

    def of(self, met: Sequence[Known]) -> list[Known]:
        """Return the conflicts to report; `met` are those that the search came upon.

        When the time runs out there are fewer of them; the diagnoses stay as complete as they are.
        """
        most, masks = self._most, self._masks
        kept: dict[int, Known] = {}
        try:
            for one in met:
                within = any(one.mask & smaller == smaller for smaller in kept)
                if len(kept) < most and not within:
                    minimal = self._minimal(one)
                    kept.setdefault(minimal.mask, minimal)
            for mask in masks[:JUSTIFIED]:
                for bit in bits(mask & ~self._forced):
                    member = 1 << bit
                    if len(kept) >= most:
                        return list(kept.values())
                    if not any(conflict & mask == member for conflict in kept):
                        found = self._outside(mask ^ member)
                        if found is not None:
                            kept.setdefault(found.mask, found)
            if not masks and not kept:
                found = self._outside(0)
                if found is not None:
                    kept[found.mask] = found
        except OutOfTime:
            pass
        return list(kept.values())

    def _minimal(self, one: Known) -> Known:
        """Return a minimal conflict inside this one, which is minimal for its own observations."""
        mask = one.mask
        if mask & (mask - 1) == 0:
            return one
        rest = mask
        for diagnosis in self._masks:
            met = mask & diagnosis
            if met & (met - 1) == 0:
                rest &= ~met
                if not rest:
                    return one
        oracle = self._oracle
        for bit in bits(rest):
            others = [variable for variable in one.components if variable != bit + 1]
            if self._conflicts.horn and oracle.propagate(self._tail + others)[0]:
                continue
            if not oracle.sat(self._tail + others):
                return self._minimal(self._shrunk())
        return one

    def _outside(self, abnormal: int) -> Known | None:
        """Return a minimal conflict outside the mask of abnormal components, or None when there is none."""
        if self._oracle.sat(self._tail + outside(self._health, abnormal | self._forced)):
            return None
        return self._minimal(self._shrunk())

    def _shrunk(self) -> Known:
        """Return a conflict inside the core of the last question, minimal for its own observations."""
        oracle, what_if = self._oracle, self._what_if
        known = self._conflicts.shrink(oracle, oracle.core() or (), self._observed, what_if)
        if what_if is NOTHING_SUPPOSED:
            self._conflicts.keep(known)
        return known
