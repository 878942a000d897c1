"""Minimal diagnoses as minimal hitting sets, smallest first, over integer bit masks.

The minimal diagnoses are the minimal hitting sets of the conflicts (Reiter 1987). Conflicts are found on
demand:

    hitting set of the known conflicts ──► consistent?  yes ──► diagnosis
              ▲                                │ no
              └──────── new conflict ◄─────────┘

For each size k in turn a depth-first search branches on a conflict that is not hit yet. The i-th branch
takes the i-th component and excludes the ones before it, so that each set is met once; what is left with one
component is taken at once. A branch is cut when k is too small even for the disjoint conflicts that remain. A
new conflict at a leaf makes it an inner node; the tree above it stays right, because it only ever branched on
true conflicts.

Why every minimal diagnosis H of size k is met: at each node some component of the conflict is in H; the first
such branch keeps `taken ⊆ H` and excludes nothing of H. A consistent leaf inside H is H, as H is minimal.

References:
    R. Reiter. A theory of diagnosis from first principles. AIJ 32(1), 1987.
    E. Moreno-Centeno, R. Karp. The implicit hitting set approach. OR 61(2), 2013.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

MAX_DEPTH = 250
"""Of the recursion, far below Python's own limit."""

CHECK_EVERY = 64
"""Nodes between two looks at the clock."""

ANY_SIZE = 1 << 62

FindConflict = Callable[[int], int | None]
"""Takes the mask of the abnormal components; returns a conflict outside it, or None: consistent."""


class TooManyNodes(Exception):
    """The node budget is spent; another search should go on from the diagnoses found."""


def no_more_conflicts(mask: int) -> None:
    """Say that what hits the known conflicts is a diagnosis: a FindConflict where all of them are known."""
    return


class HittingSets:
    """The search. `conflicts` and `found` may be read at any time.

    Args:
        find_conflict: see there.
        node_budget: nodes after which TooManyNodes is raised, None: no bound.
        known: conflicts to begin with.
        check: called now and then; may raise to end the search.
    """

    def __init__(
        self,
        find_conflict: FindConflict,
        node_budget: int | None = None,
        known: Iterable[int] = (),
        check: Callable[[], None] = lambda: None,
    ) -> None:
        self.conflicts: list[int] = list(known)
        self.found: list[int] = []
        self.next_size = 0  # no minimal diagnosis beyond those found is smaller; right after `of_size`
        self._smaller: list[int] = []  # those found before the search that runs
        self._find_conflict = find_conflict
        self._budget = node_budget
        self._check = check
        self._nodes = 0
        self._cut_at: int | None = 0  # the least size at which something was cut; None: nothing was

    def find_disjoint(self) -> int:
        """Find conflicts that share no component, until no other is apart from them; return how many.

        No diagnosis is smaller, and whoever has many faults is not met by way of all smaller sizes.
        """
        met = count = 0
        while (conflict := self._find_conflict(met)) is not None:
            self.conflicts.append(conflict)
            met |= conflict
            count += 1
        self.next_size = count
        return count

    def of_size(self, size: int) -> Iterator[int]:
        """Yield the minimal diagnoses of exactly this size.

        Call with 0 first and then with ascending sizes; only those below `next_size` may be left out.
        """
        self._cut_at = None
        self._smaller = self.found.copy()
        for mask in self._search(0, 0, self.conflicts.copy(), 0, size, 0):
            self.found.append(mask)
            yield mask
        self.next_size = size + 1 if self._cut_at is None else self._cut_at

    @property
    def exhausted(self) -> bool:
        """Whether the last `of_size` cut nothing for its size: then there is no larger minimal diagnosis."""
        return self._cut_at is None

    def any_more(self) -> bool:
        """Return whether there is a diagnosis that contains none of those found, whatever its size."""
        self._smaller = self.found.copy()
        for _ in self._search(0, 0, self.conflicts.copy(), 0, ANY_SIZE, 0):
            return True
        return False

    def _search(
        self, taken: int, excluded: int, unhit: list[int], depth: int, size: int, level: int
    ) -> Iterator[int]:
        """Yield the diagnoses with all that is taken and nothing that is excluded.

        `unhit` are the conflicts that what is taken does not hit, without what is excluded; none is empty.
        `depth` is the number of those taken, `level` that of the calls.
        """
        self._spend(1)
        if not unhit:
            if self._contains_smaller(taken):
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
        used = disjoint = forced = 0
        branch, width = 0, ANY_SIZE
        for conflict in unhit:
            if not conflict & used:
                used |= conflict
                disjoint += 1
            count = conflict.bit_count()
            if count == 1:
                forced |= conflict
            if count < width:
                branch, width = conflict, count
        least = depth + max(disjoint, forced.bit_count())
        if least > size:
            self._cut(least)
            return
        if level > MAX_DEPTH:
            raise TooManyNodes
        if forced:
            depth += forced.bit_count()
            left = [conflict for conflict in unhit if not conflict & forced]
            yield from self._search(taken | forced, excluded, left, depth, size, level + 1)
            return
        if depth + 1 == size:
            yield from self._last(taken, branch, unhit, size)
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
            yield from self._search(taken | bit, excluded, left, depth + 1, size, level + 1)
            excluded |= bit

    def _last(self, taken: int, branch: int, unhit: list[int], size: int) -> Iterator[int]:
        """Yield the diagnoses with one component more, which must hit all that is not hit yet."""
        common = branch
        for conflict in unhit:
            common &= conflict
        if common != branch:
            self._cut(size + 1)
        self._spend(common.bit_count())
        while common:
            bit = common & -common
            common ^= bit
            mask = taken | bit
            if self._contains_smaller(mask):
                continue
            found = self._find_conflict(mask)
            if found is None:
                yield mask
            else:
                self.conflicts.append(found)
                common &= found
                self._cut(size + 1)

    def _cut(self, size: int) -> None:
        if self._cut_at is None or size < self._cut_at:
            self._cut_at = size

    def _spend(self, nodes: int) -> None:
        self._nodes += nodes
        if self._nodes >= CHECK_EVERY:
            self._nodes = 0
            self._check()
        if self._budget is not None:
            self._budget -= nodes
            if self._budget < 0:
                raise TooManyNodes

    def _contains_smaller(self, mask: int) -> bool:
        return bool(self._smaller) and any(mask & smaller == smaller for smaller in self._smaller)
