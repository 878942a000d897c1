"""Which conflicts are reported: enough to show why each member of each diagnosis is needed; or all of them.

D without c is no diagnosis, so some conflict meets D in c alone. And a conflict C is minimal if for each of
its members c there is a diagnosis that meets C in c alone: then the others can be healthy together. Both are
looked up first among what the search found, and asked of the solver where that does not settle it.

Questions are bounded. A conflict that was not made minimal within the bound is told as such; conflicts that
found no room, or no time, are said to be missing. The diagnoses are what they are either way.

Conflicts of circuits have hundreds of gates, and to make one minimal takes longer than to find the diagnosis:
so it does wherever a SAT solver had the diagnosis sooner. There two walks over the gates find what they can
(circuits/traces.py), the solver's cores tell the rest, and neither is made smaller than a few questions make
it. All minimal conflicts are listed where they are asked for: sets of components that may be healthy
together, as far as is known, are tried until there is none left.

    set that no known conflict is in ──► consistent?  yes ──► none of its subsets again
              ▲                               │ no
              └─── none that contains it ◄── minimal conflict

Source: M. Liffiton, A. Previti, A. Malik, J. Marques-Silva. Fast, flexible MUS enumeration. Constraints
21(2), 2016.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

from robomend.diagnosis.conflicts import Conflicts, Known
from robomend.diagnosis.consistency import Consistency
from robomend.diagnosis.derivations import Derivation
from robomend.diagnosis.masks import bits, mask_of, members, minimal_masks, outside
from robomend.diagnosis.observed import NOTHING_SUPPOSED, SignedObs, Supposed
from robomend.diagnosis.oracle import Oracle, OutOfTime
from robomend.diagnosis.parts import COMPARED_CONFLICTS
from robomend.diagnosis.search import SearchState

if TYPE_CHECKING:
    from robomend.diagnosis.circuits.traces import Walk

MAX_CONFLICTS = 100
MAX_CIRCUIT_CONFLICTS = 32
"""Reported conflicts. Those of circuits have hundreds of gates."""

MAX_OF_ALL = 1_000
"""The same where all are asked for."""

CORES = 32
CORE_CONFLICTS = 100
CORE_PROPAGATIONS = 20
"""Questions to the solver for conflicts of a circuit, and the bounds of each, the latter a variable."""

NARROW = 12
NARROW_CALLS = 24
"""Up to so many components such a core is made minimal, in so many questions: its clauses are few."""

TOLD_ANYHOW = 5_000
"""Components of conflicts that are known and put into words even if the time is up: some milliseconds."""

JUSTIFIED = 100
"""Diagnoses that are looked at when conflicts are gathered."""


FindWalk = Callable[[Sequence[Iterable[int]]], "Walk | None"]
"""Takes sets of abnormal components, a lane each; None: this circuit is not simulated."""


class Justification:
    """The conflicts behind the diagnoses of one call, given as bit masks.

    Args:
        everything: all minimal conflicts are asked for.
        walk: how a circuit is simulated.
    """

    def __init__(
        self,
        conflicts: Conflicts,
        consistency: Consistency,
        observed: SignedObs,
        what_if: Supposed,
        masks: Sequence[int],
        *,
        everything: bool = False,
        walk: FindWalk = lambda _: None,
    ) -> None:
        self.whole = False  # all minimal conflicts are told, and nothing but them
        self._everything = everything
        self._walk = walk
        self._circuit = consistency.cnf.circuit and consistency.cnf.weak
        self._rough: list[Known] = []  # one that there was no time to make smaller
        self.complete = True  # each member of each diagnosis looked at is needed by one of them
        self._conflicts = conflicts
        self._consistency = consistency
        self._clock = consistency.clock
        self._observed = observed
        self._what_if = what_if
        self._masks = masks
        self._most = MAX_CIRCUIT_CONFLICTS if consistency.cnf.circuit else MAX_CONFLICTS
        if everything:
            self._most = MAX_OF_ALL
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
            if self._everything:
                return self._all_minimal()
            if self._circuit or (answer.cores and not met and self._consistency.cnf.weak):
                return self._within_bounds(answer.cores)
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

    # --- of circuits, and where a SAT solver searched ---------------------------------------------

    def _within_bounds(self, met: Sequence[list[int]]) -> list[Known]:
        """Return for each member of the first diagnoses a conflict that needs it, within the bounds.

        Args:
            met: cores that the search came upon.
        """
        kept: dict[int, Known] = {}
        masks = self._masks[:JUSTIFIED]
        try:
            self._searched(met, masks[0] if masks else 0, kept)
            self._simulated(masks[:1], kept)  # what explains the first mostly explains others, too
            if len(masks) > 1:
                self._simulated(masks, kept)
            cores = CORES
            for mask, member in self._lacking(masks, kept) if masks else [(0, 0)]:
                if cores and len(kept) < self._most and not _needed(member, mask, kept):
                    cores -= 1
                    self._keep_one(self._core_outside(mask ^ member), kept)
            self.complete = not self._lacking(masks, kept)
        except OutOfTime:
            self.complete = False
            for one in self._rough:
                self._keep_one(one, kept)
        return list(kept.values())

    def _searched(self, met: Sequence[list[int]], mask: int, kept: dict[int, Known]) -> None:
        """Add of the search's own cores those that meet the first diagnosis in one member, one for each."""
        for core in met:
            one = mask_of([literal for literal in core if 0 < literal <= len(self._consistency.health)])
            alone = one & mask & ~self._forced
            if alone & (alone - 1) or one & self._forced or not alone or len(kept) >= self._most:
                continue
            if not _needed(alone, mask, kept):
                self._keep_one(self._smaller(core), kept)

    def _simulated(self, masks: Sequence[int], kept: dict[int, Known]) -> None:
        """Add the conflicts that simulation shows for members of these diagnoses that still need one."""
        self._clock.check()
        lacking = self._lacking(masks, kept)
        walk = self._walk([members(mask ^ member) for mask, member in lacking]) if lacking else None
        if walk is not None:
            for lane, (mask, member) in enumerate(lacking):
                if len(kept) < self._most and not _needed(member, mask, kept):
                    self._keep_one(walk.conflict(lane), kept)

    @staticmethod
    def _keep_one(found: Known | None, kept: dict[int, Known]) -> None:
        if found is not None:
            kept.setdefault(found.mask, found)

    def _lacking(self, masks: Sequence[int], kept: Iterable[int]) -> list[tuple[int, int]]:
        """Return the members of these diagnoses, each as a mask, that no conflict shows to be needed."""
        return [
            (mask, 1 << bit)
            for mask in masks
            for bit in bits(mask & ~self._forced)
            if not _needed(1 << bit, mask, kept)
        ]

    def _core_outside(self, abnormal: int) -> Known | None:
        """Return a conflict outside the mask, if the solver finds one soon, made smaller in few steps."""
        asked = [*self._observed.numbers, *self._what_if.numbers]
        asked += outside(self._consistency.health, abnormal | self._forced)
        core = self._core_of(asked)
        return None if core is None else self._smaller(core)

    def _core_of(self, asked: list[int]) -> list[int] | None:
        """Return which of these contradict each other, if the solver sees soon that some do."""
        oracle = self._consistency.oracle
        propagations = CORE_PROPAGATIONS * self._consistency.cnf.variables
        refuted = oracle.quickly(asked, CORE_CONFLICTS, propagations) is False
        return oracle.core() or [] if refuted else None

    def _smaller(self, core: list[int]) -> Known:
        """Return a conflict inside a core: another order mostly needs less; a narrow one is made minimal."""
        self._rough = [self._conflicts.rough(core, self._what_if)]
        smaller = self._core_of(core[::-1])
        if smaller is not None and 10 * len(smaller) < 9 * len(core):
            core = smaller
            core = self._core_of(core[::-1]) or core
        found = self._conflicts.rough(core, self._what_if)
        if len(found.components) <= NARROW:
            found = self._conflicts.minimise(
                self._consistency.oracle, core, self._observed, self._what_if, calls=NARROW_CALLS
            )
        self._rough = []
        return found

    # --- all of them, one by one ------------------------------------------------------------------

    def _all_minimal(self) -> list[Known]:
        """Return all minimal conflicts, as many as there is time and room for."""
        found: list[Known] = []
        try:
            for one in self._enumerated():
                if len(found) >= self._most:
                    break
                found.append(one)
            else:
                self.whole = all(one.minimal for one in found)
        except OutOfTime:
            found += self._rough
        self.complete = self.whole or not self._lacking(self._masks, [one.mask for one in found])
        return found

    def _enumerated(self) -> Iterator[Known]:
        oracle = self._consistency.oracle
        tail = [*self._observed.numbers, *self._what_if.numbers]
        fixed = self._what_if.healthy | self._what_if.abnormal
        suspects = [variable for variable in self._consistency.health if variable not in fixed]
        untried = Oracle([], self._clock, self._consistency.solver)
        try:
            untried.set_phases(suspects)  # large sets first
            while untried.sat([]):
                healthy = set(suspects).difference([-one for one in untried.model() or () if one < 0])
                if oracle.sat([*tail, *healthy]):
                    healthy.update(set(oracle.model() or ()).intersection(suspects))  # by chance
                    for one in suspects:
                        if one not in healthy and oracle.sat([*tail, *healthy, one]):
                            healthy.add(one)
                    untried.add([one for one in suspects if one not in healthy])
                    continue
                core = oracle.core() or []
                self._rough = [self._conflicts.rough(core, self._what_if)]
                one_found = self._conflicts.minimise(oracle, core, self._observed, self._what_if)
                self._rough = []
                untried.add([-one for one in one_found.components])
                yield one_found
        finally:
            untried.close()

    # --- all conflicts are known ------------------------------------------------------------------

    def _of_all(self, derived: Sequence[Derivation], masks: Sequence[int]) -> list[Known]:
        """Return the minimal ones of all conflicts; of many, those that show what is needed."""
        told: dict[int, Known] = {}
        width = 0
        try:
            if self._everything:
                masks = minimal_masks(masks, self._clock.check)
                self.whole = len(masks) <= self._most
                masks = masks[: self._most]
                self.complete = self.whole or not self._lacking(self._masks[:JUSTIFIED], masks)
            elif len(masks) <= COMPARED_CONFLICTS:
                self.whole = len(masks) < 2 or len(minimal_masks(masks)) == len(masks)
            else:
                masks = self._chosen(masks)
            wanted = frozenset(masks)
            for one in derived:
                if one.mask in wanted and one.mask not in told:
                    width += one.mask.bit_count()
                    if width > TOLD_ANYHOW:
                        self._clock.check()
                    told[one.mask] = self._conflicts.derived(one, self._consistency.oracle, self._what_if)
        except OutOfTime:
            self.complete = self.whole = False
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


def _needed(member: int, mask: int, conflicts: Iterable[int]) -> bool:
    """Return whether one of the conflicts meets the diagnosis in this member alone."""
    return any(conflict & mask == member for conflict in conflicts)
