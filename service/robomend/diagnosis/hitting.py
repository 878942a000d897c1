"""Minimal diagnoses as minimal hitting sets, smallest first, over integer bit masks.

The minimal diagnoses are the minimal hitting sets of the conflicts (Reiter 1987). Conflicts are found on
demand:

    hitting set of the known conflicts ──► consistent?  yes ──► diagnosis
              ▲                                │ no
              └──────── new conflict ◄─────────┘

For each size k in turn a depth-first search branches on a conflict that is not hit yet. The i-th branch
takes the i-th component and excludes the ones before it, so that each set is met once. A branch is cut when
k is too small even for the disjoint conflicts that remain. A new conflict at a leaf makes it an inner node;
the tree above it stays right, because it only ever branched on true conflicts.

Why every minimal diagnosis H of size k is met: at each node some component of the conflict is in H; the first
such branch keeps `taken ⊆ H` and excludes nothing of H. A consistent leaf inside H is H, as H is minimal.

References:
    R. Reiter. A theory of diagnosis from first principles. AIJ 32(1), 1987.
    E. Moreno-Centeno, R. Karp. The implicit hitting set approach. OR 61(2), 2013.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

MAX_DEPTH = 250
"""Of the recursion, far below Python's own limit."""

FindConflict = Callable[[int], int | None]
"""Takes the mask of the abnormal components; returns a conflict outside it, or None: consistent."""


class TooManyNodes(Exception):
    """The node budget is spent; another search should go on from the diagnoses found."""


class HittingSets:
    """The search. `conflicts` and `found` may be read at any time; some conflicts may be known."""

    def __init__(
        self, find_conflict: FindConflict, conflicts: list[int], node_budget: int | None = None
    ) -> None:
        self.conflicts = conflicts
        self.found: list[int] = []
        self.size = 0  # all diagnoses below this size are in `found`
        self._found_set: set[int] = set()
        self._find_conflict = find_conflict
        self._budget = node_budget
        self._cut = False

    def of_size(self, size: int) -> Iterator[int]:
        """Yield the minimal diagnoses of exactly this size; call with 0, 1, 2, …, none left out."""
        self._cut = False
        for mask in self._search(0, 0, list(self.conflicts), 0, size):
            self.found.append(mask)
            self._found_set.add(mask)
            yield mask
        self.size = size + 1

    @property
    def exhausted(self) -> bool:
        """Whether the last `of_size` cut nothing for its size: then there is no larger minimal diagnosis."""
        return not self._cut

    def any_more(self, components: int) -> bool:
        """Return whether there is a diagnosis that contains none of those found, whatever its size."""
        for _ in self._search(0, 0, list(self.conflicts), 0, components):
            return True
        return False

    def lower_bound(self) -> int:
        """Return a size that every diagnosis has at least: a greedy count of disjoint conflicts."""
        used = bound = 0
        for conflict in sorted(self.conflicts, key=int.bit_count):
            if not conflict & used:
                used |= conflict
                bound += 1
        return bound

    def _search(self, taken: int, excluded: int, unhit: list[int], depth: int, size: int) -> Iterator[int]:
        if depth > MAX_DEPTH:
            raise TooManyNodes
        if self._budget is not None:
            self._budget -= 1
            if self._budget < 0:
                raise TooManyNodes
        while not unhit:
            if taken in self._found_set or any(taken & smaller == smaller for smaller in self.found):
                return
            conflict = self._find_conflict(taken)
            if conflict is None:
                yield taken
                return
            self.conflicts.append(conflict)
            conflict &= ~excluded
            if not conflict:
                return
            unhit = [conflict]
        if depth >= size:
            self._cut = True
            return
        used = disjoint = 0
        branch, width = 0, 1 << 62
        for conflict in unhit:
            if not conflict & used:
                used |= conflict
                disjoint += 1
            count = conflict.bit_count()
            if count < width:
                branch, width = conflict, count
        if depth + disjoint > size:
            self._cut = True
            return
        known = len(self.conflicts)
        while branch:
            bit = branch & -branch
            branch ^= bit
            allowed = ~excluded
            left = [conflict & allowed for conflict in unhit if not conflict & bit]
            if len(self.conflicts) > known:  # some were found below our earlier branches
                chosen = taken | bit
                left += [conflict & allowed for conflict in self.conflicts[known:] if not conflict & chosen]
            if 0 in left:
                return  # what is excluded is all that could hit it, and later branches exclude more
            yield from self._search(taken | bit, excluded, left, depth + 1, size)
            excluded |= bit
