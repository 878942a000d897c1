"""Diagnoses as products: what goes wrong in one part of the system says nothing of another.

Conflicts that share no component fall into parts. A minimal diagnosis takes one *alternative* from each part,
a minimal hitting set of its conflicts, whatever it takes from the others:

    conflicts   {a, b}   {c, d} {d, e}          parts   {a, b}   {c, d, e}
                                                        a | b    d | c e          2 × 2 = 4 diagnoses

So twenty broken topics are twenty short lists instead of a million rows, and the number of diagnoses is a
product. Within a part, components that occur in the same conflicts can stand for one another: one of them,
their *class*, is searched with, and the others are put in afterwards. The first few diagnoses in order of
size are those with the least sum of sizes, found without listing the rest.

Sources:
    R. Reiter. A theory of diagnosis from first principles. AIJ 32(1), 1987 (hitting sets).
    E. Lawler. A procedure for computing the k best solutions to discrete optimization problems. Management
        Science 18(7), 1972 (the first few by their sum).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from heapq import heappop, heappush
from itertools import islice, product
from math import prod

from robomend.diagnosis.core_guided import MinimumTooLarge
from robomend.diagnosis.guided import CheapestHittingSets
from robomend.diagnosis.hitting import HittingSets, TooManyNodes, no_more_conflicts
from robomend.diagnosis.masks import bits, classes_of, members, minimal_masks
from robomend.diagnosis.oracle import Deadline, OutOfTime
from robomend.diagnosis.result import Options
from robomend.diagnosis.search import Row, SearchState

Cost = Callable[[int], float]
"""What an alternative costs, by its mask: its size, or that and what tells those of one size apart."""

NODE_BUDGET = 20_000
"""Nodes of a search for hitting sets before a SAT search takes over."""

COMPARED_CONFLICTS = 64
"""Up to which all pairs of them are compared to drop what contains another."""

MULTIPLIED_OUT = 64
"""Diagnoses up to which they are simply multiplied out."""

MAX_ALTERNATIVES = 1_000
"""Of a part, that are listed as one factor. A part with more is told by its classes, as rows of its own."""

MAX_ROWS = 1_000
"""Of the whole answer."""

WEIGHED = 20_000
"""Alternatives of a part whose cost is looked at, so that the cheapest of one size come first."""

FACTORED_LISTED = 100
"""Diagnoses that are listed beside the factored form where no limit is given."""


def independent(conflicts: Sequence[int]) -> list[list[int]]:
    """Return the conflicts in groups; those of different groups share no component."""
    groups: list[tuple[int, list[int]]] = []
    everything = 0
    for conflict in conflicts:
        if not conflict & everything:
            groups.append((conflict, [conflict]))
        else:
            mask, together = conflict, [conflict]
            apart = []
            for group in groups:
                if group[0] & conflict:
                    mask |= group[0]
                    together = group[1] + together
                else:
                    apart.append(group)
            groups = [*apart, (mask, together)]
        everything |= conflict
    return [group for _, group in groups]


def minimal(conflicts: Sequence[int]) -> list[int]:
    """Return the conflicts without those that contain another; of many, those that differ."""
    once = list(dict.fromkeys(conflicts))
    return minimal_masks(once) if 1 < len(once) <= COMPARED_CONFLICTS else once


class IndependentPart:
    """The alternatives of one part, smallest first, found as they are needed."""

    def __init__(self) -> None:
        self.found: list[int] = []  # of one component a class
        self.count = 0  # of alternatives behind those found
        self.done = False  # there are no others up to the size that was asked for last
        self.search: HittingSets | None = None
        self._classes: Mapping[int, int] = {}  # lowest component, as a mask -> its class, if of several
        self._clock: Deadline | None = None
        self._last_size: int | None = None
        self._solving = False  # the search had too many nodes
        self._cut = False  # by that size, not because there is nothing more
        self._coming: Iterator[int] = iter(())
        self._listed: list[int] | None = None

    @classmethod
    def of(cls, conflicts: Sequence[int], clock: Deadline) -> IndependentPart:
        """Return the part of these conflicts, which are all there are."""
        if len(conflicts) == 1:
            return cls._of_one(conflicts[0])
        classes = {one & -one: one for one in classes_of(conflicts, clock.check)}
        firsts = sum(classes)
        known = dict.fromkeys(conflict & firsts for conflict in conflicts)
        part = cls.of_search(HittingSets(no_more_conflicts, NODE_BUDGET, known, clock.check))
        part._classes = {first: together for first, together in classes.items() if first != together}
        part._clock = clock
        return part

    @classmethod
    def _of_one(cls, conflict: int) -> IndependentPart:
        """Return the part of a single conflict: any one of its components."""
        part = cls()
        first = conflict & -conflict
        part.found = [first]
        part.count = conflict.bit_count()
        part.done = True
        part._classes = {first: conflict}
        return part

    @classmethod
    def of_search(cls, search: HittingSets) -> IndependentPart:
        """Return a part whose conflicts are found on the way; TooManyNodes where they are too many."""
        part = cls()
        part.search = search
        part._coming = part._generated(search)
        return part

    def extend(self, wanted: int, last_size: int | None, searched: int = 0) -> None:
        """Find alternatives of up to `last_size` components until there are as many as are wanted.

        Args:
            searched: go on until there are so many of one component a class, to know how many there are; not
                where that takes a solver.

        Raises:
            TooManyNodes: another search must go on, as not all conflicts are known.
            OutOfTime, and what the search's own question raises.
        """
        self._last_size = last_size
        while not self.done and (self.count < wanted or (len(self.found) < searched and not self._solving)):
            mask = next(self._coming, None)
            if mask is not None:
                self.found.append(mask)
                self.count += self._behind(mask)
            self.done = not mask  # the empty one has no others beside it

    @property
    def beyond(self) -> bool:
        """Whether there are alternatives that are larger than was asked for."""
        return self._cut and self.search is not None and self.search.any_more()

    @property
    def least(self) -> int:
        """How many components the smallest alternative has; one must have been found."""
        return self.found[0].bit_count()

    def alternatives(self) -> Iterator[int]:
        """Yield the alternatives found, smallest first: for each class one of its components."""
        if not self._classes:
            yield from self.found
            return
        for mask in self.found:
            factors = self.factors(mask)
            yield from factors[0] if len(factors) == 1 else map(sum, product(*factors))

    def listed(self) -> list[int]:
        """Return the alternatives of a part that is done; the list is kept, for it may be asked for often."""
        if self._listed is None:
            self._listed = list(self.alternatives())
        return self._listed

    def factors(self, mask: int) -> list[list[int]]:
        """Return what may stand for each member of an alternative, as masks."""
        return [[1 << other for other in bits(self._classes.get(1 << bit, 1 << bit))] for bit in bits(mask)]

    def _behind(self, mask: int) -> int:
        if not self._classes:
            return 1
        return prod(self._classes.get(1 << bit, 1).bit_count() for bit in bits(mask))

    def _generated(self, search: HittingSets) -> Iterator[int]:
        try:
            while not search.exhausted:
                if self._last_size is not None and search.next_size > self._last_size:
                    self._cut = True
                    return
                yield from search.of_size(search.next_size)
        except TooManyNodes:
            if self._clock is None:
                raise
            yield from self._cheapest(search.conflicts, self._clock)

    def _cheapest(self, conflicts: Sequence[int], clock: Deadline) -> Iterator[int]:
        """Go on, core-guided, from what was found."""
        self._solving = True
        sets = CheapestHittingSets([1] * max(map(int.bit_length, conflicts)), clock)
        try:
            for conflict in conflicts:
                sets.hit(conflict)
            for known in self.found:
                sets.block(known)
            while (mask := sets.next()) is not None:
                if self._last_size is not None and mask.bit_count() > self._last_size:
                    self._cut = True
                    return
                yield mask
                sets.block(mask)
        finally:
            sets.close()


def one_of_each(conflicts: Sequence[int]) -> list[int]:
    """Return the minimal hitting sets of conflicts that share no component: one of each, in all ways."""
    found = [0]
    for conflict in conflicts:
        members_of = []
        while conflict:
            bit = conflict & -conflict
            members_of.append(bit)
            conflict ^= bit
        found = [mask | bit for mask in found for bit in members_of]
    return found


def smallest(parts: Sequence[IndependentPart], most: int, cost: Cost = int.bit_count) -> Iterator[int]:
    """Yield up to `most` diagnoses, one alternative of each part joined, in order of cost.

    States are (cost, part, position, mask): from the parts in order of what their second alternative costs
    more, the last one that was moved on, and where it is. Each choice is reached in one way only.

    Args:
        cost: that of a diagnosis is the sum of that of its alternatives.
    """
    first = 0
    open_: list[list[tuple[float, int]]] = []
    for part in parts:
        by_size = cost is int.bit_count  # the order in which they come
        wanted = islice(part.alternatives(), most if by_size else max(most, WEIGHED))
        alternatives = [(cost(mask), mask) for mask in wanted]
        if not by_size:
            alternatives.sort()
        first |= alternatives[0][1]
        if len(alternatives) > 1:
            open_.append(alternatives)
    yield first
    open_.sort(key=lambda one: one[1][0] - one[0][0])
    heap: list[tuple[float, int, int, int]] = []

    def push(total: float, mask: int, part: int, position: int, before: int) -> None:
        """Move a part on from where it was before."""
        if part < len(open_) and position < len(open_[part]):
            (old_cost, old), (new_cost, new) = open_[part][before], open_[part][position]
            heappush(heap, (total - old_cost + new_cost, part, position, mask ^ old | new))

    push(0, first, 0, 1, 0)
    while heap and (most := most - 1) > 0:
        total, moved, position, mask = heappop(heap)
        yield mask
        push(total, mask, moved, position + 1, position)
        push(total, mask, moved + 1, 1, 0)
        if position == 1:
            (old_cost, old), (new_cost, new) = open_[moved][1], open_[moved][0]
            push(total - old_cost + new_cost, mask ^ old | new, moved + 1, 1, 0)


def rows_of(parts: Sequence[IndependentPart], forced: int) -> list[Row]:
    """Return all diagnoses, one alternative of each part and all that is forced, as products.

    None are returned if they are too many.
    """
    rows: list[Row] = [tuple(((variable,),) for variable in members(forced))]
    for part in parts:
        choices: list[Row]
        if len(part.found) > 1 and part.count <= MAX_ALTERNATIVES:
            choices = [(tuple(map(members, part.alternatives())),)]
        else:
            choices = [
                tuple(tuple(map(members, factor)) for factor in part.factors(mask)) for mask in part.found
            ]
        rows = [row + choice for row in rows for choice in choices]
        if len(rows) > MAX_ROWS:
            return []
    return rows


def list_diagnoses(
    parts: Sequence[IndependentPart],
    forced: int,
    options: Options,
    answer: SearchState,
    counted: int,
    cost: Cost = int.bit_count,
) -> None:
    """Hand on the diagnoses that take one alternative of each part and all that is forced, smallest first.

    Args:
        counted: alternatives of each part to look for, so that there is an exact count beyond the limit; not
            where one diagnosis is asked for.
        cost: by which they are listed; of two diagnoses the smaller one must cost less.

    Raises:
        LimitReached, MinimumTooLarge, OutOfTime: see robomend.diagnosis.search.
        TooManyNodes: see IndependentPart.extend.
    """
    room = None if options.max_size is None else options.max_size - forced.bit_count()
    least = 0
    for part in parts:
        part.extend(1, None if room is None else room - least)
        if not part.found:
            raise MinimumTooLarge
        least += part.least
    if room is not None and least > room:
        raise MinimumTooLarge
    by_minimum = options.minimal == "cardinality"
    spare = 0 if by_minimum else None if room is None else room - least
    wanted, counted = (1, 0) if answer.limit == 1 else (answer.limit + 1, counted)
    try:
        for part in parts:
            part.extend(wanted, None if spare is None else part.least + spare, counted)
    except OutOfTime:
        # What is missing in a part is no smaller than the last alternative found there.
        sure = least + min(part.found[-1].bit_count() - part.least for part in parts if not part.done)
        for mask in smallest(parts, answer.limit, cost):
            if mask.bit_count() <= sure:
                answer.add(members(mask | forced))
        raise
    if all(part.done for part in parts):
        largest = sum(part.found[-1].bit_count() for part in parts)
        if by_minimum or room is None or (largest <= room and not any(part.beyond for part in parts)):
            room = None
            answer.count = prod(part.count for part in parts)
            if options.factored or 1 < answer.limit < answer.count:
                answer.rows = rows_of(parts, forced)
            if not options.factored and answer.count <= min(MULTIPLIED_OUT, answer.limit):
                found = [forced]
                for part in parts:
                    alternatives = part.listed()
                    found = [mask | one for mask in found for one in alternatives]
                answer.found = [members(mask) for mask in found]
                return
    if options.factored and answer.rows:
        listed = answer.limit if options.limit is not None else FACTORED_LISTED
        answer.found.extend(members(mask | forced) for mask in smallest(parts, listed, cost))
        return
    for mask in smallest(parts, answer.limit + 1, cost):
        if room is not None and not by_minimum and mask.bit_count() > room:
            raise MinimumTooLarge
        answer.add(members(mask | forced))
    if room is not None and not by_minimum:
        raise MinimumTooLarge
