"""Diagnoses as hitting sets of conflicts: the way of robots.

    all conflicts can be listed (derivations.py)    the parts that share no component, each by itself
    not Horn, one diagnosis or a bound on size      by_solver.py
    else                                            conflicts on demand: a solver call at each leaf
        several conflicts apart from one another    the regions of the model (below), each by itself
        too many nodes, or too wide                 by_solver.py goes on from what was found
    order of probability                            few conflicts: listed and sorted; else ranking.py

What the parts give is put together by parts.py: the first few in order of size, all as a product, their
number.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import suppress
from functools import reduce
from math import prod
from operator import or_

from robomend.diagnosis.by_solver import BySolver
from robomend.diagnosis.conflicts import Conflicts, Known
from robomend.diagnosis.consistency import Consistency
from robomend.diagnosis.core_guided import MinimumTooLarge
from robomend.diagnosis.hitting import HittingSets, TooManyNodes
from robomend.diagnosis.masks import mask_of, members, outside
from robomend.diagnosis.observed import NOTHING_SUPPOSED, SignedObs, Supposed
from robomend.diagnosis.oracle import OutOfTime
from robomend.diagnosis.parts import (
    MULTIPLIED_OUT,
    IndependentPart,
    independent,
    list_diagnoses,
    minimal,
    one_of_each,
    smallest,
)
from robomend.diagnosis.ranking import by_probability, odds_against, size_then_odds
from robomend.diagnosis.result import Options
from robomend.diagnosis.search import NoDiagnosis, SearchState
from robomend.model.cnf import Clause, HealthCnf

COUNTED = 5_000
"""Alternatives of a part that are listed, whatever the limit, for the exact count."""

SEARCHED_NODES = 2_000
"""Nodes of a search that asks the solver at its leaves."""

RANKED_CONFLICTS = 64
RANKED_ALTERNATIVES = 1_000
"""Of a part, that are listed and sorted by probability; more are searched for in that order."""

WIDE_CONFLICT = 60
"""The hitting-set tree branches this much at most; wider conflicts go to a SAT search."""

WIDE_CORE = 24
"""Where the solver has to be asked to make a core smaller, a wider one goes to a SAT search as it is: the
diagnoses are found sooner than the conflict is minimal."""


class WideCore(TooManyNodes):
    """A core is wider than WIDE_CORE; `mask` are its components."""

    def __init__(self, mask: int) -> None:
        super().__init__()
        self.mask = mask


class ByConflicts:
    """See the module."""

    def __init__(self, consistency: Consistency, conflicts: Conflicts, by_solver: BySolver) -> None:
        self._consistency = consistency
        self._cnf = consistency.cnf
        self._clock = consistency.clock
        self._conflicts = conflicts
        self._by_solver = by_solver
        self._cost = size_then_odds(self._cnf) if self._cnf.priors else int.bit_count

    def list_all(self, observed: SignedObs, what_if: Supposed, options: Options, answer: SearchState) -> None:
        """List the diagnoses in order of size."""
        forced = mask_of(what_if.abnormal)
        derived = answer.derived = self._conflicts.all_of(observed, what_if)
        if derived is None:
            self._by_found_conflicts(observed, what_if, options, answer)
            return
        masks = [one.mask for one in derived]
        if 0 in masks:
            answer.minimal = [0]
            raise NoDiagnosis
        groups = independent(masks)
        answer.minimal = masks
        if len(groups) < len(masks):
            groups = [minimal(group) if len(group) > 1 else group for group in groups]
            answer.minimal = [mask for group in groups for mask in group]
        if len(groups) == len(answer.minimal) and self._few(answer, options):
            found = one_of_each(answer.minimal)
            answer.count = len(found)
            answer.found = [members(mask | forced) for mask in found]
            return
        parts = [IndependentPart.of(group, self._clock) for group in groups]
        list_diagnoses(parts, forced, options, answer, COUNTED, self._cost)

    @staticmethod
    def _few(answer: SearchState, options: Options) -> bool:
        """Return whether conflicts that share no component have so few diagnoses that all are listed."""
        if options.factored or options.max_size is not None or answer.limit == 1:
            return False
        return prod(map(int.bit_count, answer.minimal)) <= min(MULTIPLIED_OUT, answer.limit)

    def _by_found_conflicts(
        self, observed: SignedObs, what_if: Supposed, options: Options, answer: SearchState
    ) -> None:
        """Ask the solver for conflicts one by one.

        Where propagation does not decide, each takes many questions to be made minimal: the search of a SAT
        solver has one diagnosis, or those up to a size, sooner.
        """
        forced = mask_of(what_if.abnormal)
        bounded = answer.limit == 1 or options.max_size is not None
        if bounded and not (self._conflicts.horn or options.factored):
            self._by_solver.go_on(observed, what_if, options, answer, [], 0)
            return
        search = self._hitting_sets(observed, what_if, answer)
        part = IndependentPart.of_search(search)
        parts = [part]
        try:
            if self._several(search, observed, what_if) and answer.limit > 1:
                parts = self._apart(observed, what_if, answer) or parts
            list_diagnoses(parts, forced, options, answer, 0, self._cost)
        except TooManyNodes:
            known = [members(mask | forced) for mask in part.found]
            for bad in known:
                answer.add(bad)
            size = search.next_size + len(what_if.abnormal)
            self._by_solver.go_on(observed, what_if, options, answer, known, size)
        finally:
            if self._cnf.modes and len(parts) > 1:
                self._note_modes(observed, what_if, answer)

    def _several(self, search: HittingSets, observed: SignedObs, what_if: Supposed) -> bool:
        """Return whether there are conflicts apart from one another, which are found for the search."""
        try:
            return search.find_disjoint() > 1
        except WideCore as core:
            healthy = outside(self._consistency.health, core.mask | mask_of(what_if.abnormal))
            if self._consistency.oracle.sat([*observed.numbers, *what_if.numbers, *healthy]):
                raise
            return True

    def _note_modes(self, observed: SignedObs, what_if: Supposed, answer: SearchState) -> None:
        """Note the fault modes of diagnoses that were put together of parts, as far as there is time."""
        literals = [*observed.numbers, *what_if.numbers]
        with suppress(OutOfTime):
            for bad in answer.found:
                if bad not in answer.modes:
                    answer.modes[bad] = self._consistency.modes_behind(bad, literals)

    def _hitting_sets(
        self, observed: SignedObs, what_if: Supposed, answer: SearchState, region: int | None = None
    ) -> HittingSets:
        find_conflict = self._conflict_finder(observed, what_if, answer, WIDE_CONFLICT, region)
        known = [one.mask for one in answer.known if region is not None and not one.mask & ~region]
        return HittingSets(find_conflict, SEARCHED_NODES, known, self._clock.check)

    def _apart(self, observed: SignedObs, what_if: Supposed, answer: SearchState) -> list[IndependentPart]:
        """Return the regions that say nothing of one another, each as a part; none: all is one."""
        numbers = [*observed.numbers, *what_if.numbers]
        _, implied = self._consistency.oracle.propagate(numbers)
        found = regions(self._cnf, [*numbers, *implied], what_if.abnormal)
        if len(found) < 2:
            return []
        return [
            IndependentPart.of_search(self._hitting_sets(observed, what_if, answer, region))
            for region in found
        ]

    def most_probable_first(
        self, observed: SignedObs, what_if: Supposed, options: Options, answer: SearchState
    ) -> None:
        """List the subset-minimal diagnoses in order of probability."""
        forced = mask_of(what_if.abnormal)
        derived = answer.derived = self._conflicts.all_of(observed, what_if)
        if derived is None:
            find_conflict = self._conflict_finder(observed, what_if, answer, widest=len(self._cnf.components))
        else:
            masks = answer.minimal = minimal([one.mask for one in derived])
            if 0 in masks:
                raise NoDiagnosis

            def find_conflict(abnormal: int) -> int | None:
                return next((mask for mask in masks if not mask & abnormal), None)

        left_out = False
        order = None if derived is None else self._ranked(masks)
        if order is None:
            order = by_probability(find_conflict, self._cnf.components, self._cnf.priors, self._clock)
        for mask in order:
            bad = members(mask | forced)
            if options.max_size is not None and len(bad) > options.max_size:
                left_out = True
            else:
                answer.add(bad)
        if left_out:
            raise MinimumTooLarge

    def _ranked(self, conflicts: list[int]) -> Iterator[int] | None:
        """Return what hits all of a few conflicts, the most probable first; None: it is too much to list."""
        if len(conflicts) > RANKED_CONFLICTS:
            return None
        cost = odds_against(self._cnf, reduce(or_, conflicts, 0))
        parts = [IndependentPart.of(group, self._clock) for group in independent(conflicts)]
        for part in parts:
            part.extend(RANKED_ALTERNATIVES + 1, None)
            if not part.done:
                return None
        return smallest(parts, prod(part.count for part in parts), cost)

    def _conflict_finder(
        self,
        observed: SignedObs,
        what_if: Supposed,
        answer: SearchState,
        widest: int,
        region: int | None = None,
    ) -> Callable[[int], int | None]:
        """Return the question that hitting-set searches ask: a conflict outside these components, or None.

        Args:
            widest: a conflict wider than this ends the search.
            region: the components, as a mask, that alone matter; None: all.

        Raises (the question):
            TooManyNodes: a conflict is wider than `widest`, or a core than WIDE_CORE.
            NoDiagnosis: a conflict has no component.
        """
        forced = mask_of(what_if.abnormal)
        oracle, health = self._consistency.oracle, self._consistency.health
        elsewhere = 0 if region is None else ~region
        tail = [*observed.numbers, *what_if.numbers]
        plain = what_if is NOTHING_SUPPOSED
        conflicts, known = self._conflicts, answer.known
        library = conflicts.applicable(observed) if plain else []

        def find_conflict(mask: int) -> int | None:
            mask |= forced | elsewhere
            for one in known:
                if not one.mask & mask:
                    return one.mask
            for one in library:
                if not one.mask & mask:
                    known.append(one)
                    return one.mask
            # OBS first: what was seen is then no consequence of health, so that cores stay near the fault
            if oracle.sat(
                tail + (outside(health, mask) if region is None else list(members(region & ~mask)))
            ):
                if self._cnf.modes and region is None:
                    bad = members(mask)
                    answer.modes[bad] = self._consistency.modes_of(bad, oracle.model() or ())
                return None
            core = oracle.core() or ()
            if not conflicts.horn and widest == WIDE_CONFLICT and region is None and len(core) > WIDE_CORE:
                raise WideCore(conflicts.rough(core, what_if).mask)
            conflict: Known = conflicts.shrink(oracle, core, observed, what_if)
            if not conflict.mask:
                raise NoDiagnosis
            if plain:
                conflicts.keep(conflict)
            known.append(conflict)
            if conflict.mask.bit_count() > widest:
                raise TooManyNodes
            return conflict.mask

        return find_conflict


# --- regions of a model that say nothing of one another, once OBS is known.
#
# What is observed satisfies some clauses and shortens others. Clauses that still share a variable are one
# region: whether it can be healthy does not depend on what is wrong in another. A variable that occurs with
# one sign only satisfies all its clauses, so those go first; with them goes what nobody looks at.
#
#     ¬AB(a) → ok(x)         x seen not ok      region {a}
#     ¬AB(b) ∧ ok(y) → ok(z) y seen ok          z was not seen and nothing follows from it: no region
#     ¬AB(c) ∧ ok(v) → ok(w) w seen not ok  ┐
#     ¬AB(d) → ok(v)                        ┘   region {c, d}
#
# It takes time in proportion to the model, so it is done when a first diagnosis has more than one member.
# Models whose conflicts can be listed (derivations.py) do without.


def regions(cnf: HealthCnf, implied: Iterable[int], supposed_abnormal: Collection[int]) -> list[int]:
    """Return the components of each region as masks, given the literals that OBS and what-ifs imply.

    A component that must be abnormal is a region of its own, unless it is supposed to be.
    """
    true = set(implied)
    n = len(cnf.components)
    certain = [-number for number in true if -n <= number < 0 and -number not in supposed_abnormal]
    clauses: list[Clause | None] = []
    occurs: dict[int, list[int]] = {}
    for clause in cnf.clauses:
        if true.isdisjoint(clause):
            left = tuple(literal for literal in clause if -literal not in true)
            for literal in left:
                occurs.setdefault(literal, []).append(len(clauses))
            clauses.append(left)
    count = {literal: len(where) for literal, where in occurs.items()}
    pure = [literal for literal in count if abs(literal) > n and -literal not in count]
    for literal in pure:  # grows while it is read
        for index in occurs[literal]:
            clause_ = clauses[index]
            if clause_ is None:
                continue
            clauses[index] = None
            for other in clause_:
                count[other] -= 1
                if not count[other] and abs(other) > n and count.get(-other):
                    pure.append(-other)
    return [1 << (c - 1) for c in sorted(certain)] + _connected([clause for clause in clauses if clause], n)


def _connected(clauses: Iterable[Clause], components: int) -> list[int]:
    """Return the components of clauses that share variables, directly or through others."""
    leader: dict[int, int] = {}

    def find(variable: int) -> int:
        root = variable
        while leader[root] != root:
            root = leader[root]
        while leader[variable] != root:
            leader[variable], variable = root, leader[variable]
        return root

    for clause in clauses:
        first = abs(clause[0])
        leader.setdefault(first, first)
        for literal in clause[1:]:
            other = abs(literal)
            leader.setdefault(other, other)
            leader[find(other)] = find(first)
    masks: dict[int, int] = {}
    for variable in leader:
        if variable <= components:
            root = find(variable)
            masks[root] = masks.get(root, 0) | 1 << (variable - 1)
    return list(masks.values())
