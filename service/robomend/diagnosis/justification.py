"""Which conflicts are reported: minimal ones, as many as show why each member of each diagnosis is needed.

D without c is no diagnosis, so some conflict meets D in c alone. And a conflict C is minimal if for each of
its members c there is a diagnosis that meets C in c alone: then the others can be healthy together. Both are
looked up first among what the search found, and asked of the solver where that does not settle it.

Questions are bounded. A conflict that was not made minimal within the bound is told as such; conflicts that
found no room, or no time, are said to be missing. The diagnoses are what they are either way.
"""

from __future__ import annotations

from collections.abc import Sequence

from robomend.diagnosis.conflicts import Conflicts, Known
from robomend.diagnosis.consistency import Consistency
from robomend.diagnosis.derivations import Derivation
from robomend.diagnosis.masks import bits, mask_of, outside
from robomend.diagnosis.observed import NOTHING_SUPPOSED, SignedObs, Supposed
from robomend.diagnosis.oracle import OutOfTime
from robomend.diagnosis.parts import FEW
from robomend.diagnosis.search import SearchState

MAX_CONFLICTS = 100
MAX_CIRCUIT_CONFLICTS = 8
"""Reported conflicts. Those of circuits have hundreds of gates."""

TOLD_ANYHOW = 5_000
"""Components of conflicts that are known and put into words even if the time is up: some milliseconds."""

JUSTIFIED = 100
"""Diagnoses that are looked at when conflicts are gathered."""


class Justification:
    """The conflicts behind the diagnoses of one call, given as bit masks."""

    def __init__(
        self,
        conflicts: Conflicts,
        consistency: Consistency,
        observed: SignedObs,
        what_if: Supposed,
        masks: Sequence[int],
    ) -> None:
        self._rough: list[Known] = []  # one that there was no time to make smaller
        self.complete = True  # each member of each diagnosis looked at is needed by one of them
        self._conflicts = conflicts
        self._consistency = consistency
        self._clock = consistency.clock
        self._observed = observed
        self._what_if = what_if
        self._masks = masks
        self._most = MAX_CIRCUIT_CONFLICTS if consistency.cnf.circuit else MAX_CONFLICTS
        self._forced = mask_of(what_if.abnormal)

    def of(self, answer: SearchState) -> list[Known]:
        """Return the conflicts to report.

        When the time runs out there are fewer of them; the diagnoses stay as complete as they are.
        """
        if answer.derived is not None:
            return self._of_all(answer.derived, answer.minimal)
        kept: dict[int, Known] = {}
        met = list(answer.known)
        try:
            self._conflicts.reserve_telling()
            while met:
                one = met.pop(0)
                within = any(one.mask & smaller == smaller for smaller in kept)
                if len(kept) < self._most and not within:
                    minimal = self._minimal(one)
                    kept.setdefault(minimal.mask, minimal)
            self._add_needed(kept)
        except OutOfTime:
            self.complete = False
            for one in (*met, *self._rough):  # as they are: smaller ones may be inside
                if len(kept) < self._most and not any(one.mask & other == other for other in kept):
                    kept[one.mask] = Known.of(one.components, one.observations, minimal=False)
        return list(kept.values())

    def _add_needed(self, kept: dict[int, Known]) -> None:
        """Add for each member of each diagnosis a conflict that needs it, where there is none yet."""
        for mask in self._masks[:JUSTIFIED]:
            for bit in bits(mask & ~self._forced):
                member = 1 << bit
                if any(conflict & mask == member for conflict in kept):
                    continue
                if len(kept) >= self._most:
                    self.complete = False
                    return
                found = self._outside(mask ^ member)
                if found is not None:
                    kept.setdefault(found.mask, found)
        if not self._masks and not kept:
            found = self._outside(0)
            if found is not None:
                kept[found.mask] = found

    # --- all conflicts are known ------------------------------------------------------------------

    def _of_all(self, derived: Sequence[Derivation], masks: Sequence[int]) -> list[Known]:
        """Return the minimal ones of all conflicts; of many, those that show what is needed."""
        told: dict[int, Known] = {}
        width = 0
        try:
            wanted = frozenset(masks if len(masks) <= FEW else self._chosen(masks))
            for one in derived:
                if one.mask in wanted and one.mask not in told:
                    width += one.mask.bit_count()
                    if width > TOLD_ANYHOW:
                        self._clock.check()
                    told[one.mask] = self._conflicts.derived(one, self._consistency.oracle, self._what_if)
        except OutOfTime:
            self.complete = False
        return list(told.values())

    def _chosen(self, masks: Sequence[int]) -> list[int]:
        """Return for each member of the first diagnoses a conflict that needs it."""
        chosen: list[int] = []
        for diagnosis in self._masks[:JUSTIFIED]:
            for bit in bits(diagnosis & ~self._forced):
                member = 1 << bit
                if any(conflict & diagnosis == member for conflict in chosen):
                    continue
                if len(chosen) >= self._most:
                    self.complete = False
                    return chosen
                # The smallest is minimal: a conflict inside it would be among these too.
                chosen.append(min((m for m in masks if m & diagnosis == member), key=int.bit_count))
        if not chosen:
            self.complete = False
            for mask in sorted(masks, key=int.bit_count)[: self._most]:
                if not any(other & mask == other for other in chosen):
                    chosen.append(mask)
        return chosen

    # --- only those that the search met -----------------------------------------------------------

    def _minimal(self, one: Known) -> Known:
        """Return a minimal conflict inside this one, which is minimal for its own observations."""
        mask = one.mask
        if one.under is self._observed or mask & (mask - 1) == 0:
            return one
        rest = mask
        for diagnosis in self._masks:
            met = mask & diagnosis
            if met & (met - 1) == 0:
                rest &= ~met
                if not rest and one.minimal:
                    return one
        needed = [bit + 1 for bit in bits(mask & ~rest)]
        literals = [*one.components, *one.observations]
        found = self._conflicts.minimise(
            self._consistency.oracle, literals, self._observed, self._what_if, needed=needed
        )
        if found.mask == mask and found.minimal:
            return one if one.minimal else found
        self._keep(found)
        return found

    def _outside(self, abnormal: int) -> Known | None:
        """Return a minimal conflict outside the mask of abnormal components, or None when there is none."""
        oracle = self._consistency.oracle
        tail = [*self._observed.numbers, *self._what_if.numbers]
        if oracle.sat(tail + outside(self._consistency.health, abnormal | self._forced)):
            return None
        core = oracle.core() or []
        try:
            return self._minimal(self._conflicts.shrink(oracle, core, self._observed, self._what_if))
        except OutOfTime:
            if len(core) <= TOLD_ANYHOW:
                self._rough = [self._conflicts.rough(core, self._what_if)]
            raise

    def _keep(self, known: Known) -> None:
        if self._what_if is NOTHING_SUPPOSED:
            self._conflicts.keep(known)
