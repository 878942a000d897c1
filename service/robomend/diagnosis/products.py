"""Few diagnoses, multiplied out of parts that share no component, in order and as names, many times over.

    alternatives of a part, as keys      {a}  {b, c}
    those of another one                 {d}  {e}         ──► sums of keys, sorted ──► a d, a e, b c d, b c e

A set of components is one integer whose order is the one that diagnoses are listed in, size before members,
and the key of a union of disjoint sets is the sum of their keys:

    key = size · 2ⁿ − Σ 2^(n − 1 − c) over its components c         the first component weighs most

So nothing is compared but integers, and the members are in the lower n bits, negated.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from robomend.diagnosis.masks import bits
from robomend.diagnosis.parts import IndependentPart

WIDTH = 12
"""Components whose names are looked up at once."""

MOST_COMPONENTS = 512
"""Of a model; beyond, a diagnosis holds few of very many."""


class _Names(dict[int, tuple[str, ...]]):
    """Bits of WIDTH components, the first one highest -> their names."""

    def __init__(self, names: Sequence[str]) -> None:
        super().__init__()
        self._names = names

    def __missing__(self, some: int) -> tuple[str, ...]:
        found = tuple([name for place, name in enumerate(self._names) if some >> (WIDTH - 1 - place) & 1])
        self[some] = found
        return found


class Products:
    """See the module."""

    def __init__(self, components: Sequence[str], most: int) -> None:
        """`most`: diagnoses of an answer; what has more is not for here."""
        starts = range(0, len(components), WIDTH)
        self._most = most if len(components) <= MOST_COMPONENTS else 0
        self._width = WIDTH * len(starts)
        self._names = [
            (_Names(components[start : start + WIDTH]), self._width - WIDTH - start) for start in starts
        ]
        self._keys: dict[tuple[int, ...], list[int]] = {}  # of the alternatives of a part

    def of(
        self, parts: Iterable[Iterable[int]], known: Mapping[tuple[int, ...], IndependentPart]
    ) -> list[tuple[str, ...]] | None:
        """Return the diagnoses, in order; None: they are too many, or not all parts were searched to the end.

        Args:
            parts: the conflicts of each.
            known: parts by their conflicts, sorted.
        """
        count, keys_of = 1, []
        for group in parts:
            keys = self._keys.get(conflicts := tuple(sorted(group)))
            if keys is None:
                part = known.get(conflicts)
                if part is None or not part.done or part.count > self._most:
                    return None
                keys = self._keys[conflicts] = self._keyed(part.listed())
            count *= len(keys)
            if count > self._most:
                return None
            keys_of.append(keys)
        return self._listed(keys_of) if count <= self._most else None

    def forget(self) -> None:
        """Forget the alternatives of all parts: they are searched anew."""
        self._keys.clear()

    def _keyed(self, masks: Iterable[int]) -> list[int]:
        """Return the keys of sets of components, given as masks."""
        return [
            (mask.bit_count() << self._width) - sum(1 << (self._width - 1 - bit) for bit in bits(mask))
            for mask in masks
        ]

    def _listed(self, parts: Iterable[Sequence[int]]) -> list[tuple[str, ...]]:
        """Return the unions of one set of each part, given by their keys."""
        found = [0]
        for keys in parts:
            found = [union + key for union in found for key in keys]
        found.sort()
        all_, low = (1 << self._width) - 1, (1 << WIDTH) - 1
        told = []
        for key in found:
            members = -key & all_
            names: tuple[str, ...] = ()
            for table, shift in self._names:
                names += table[members >> shift & low]
            told.append(names)
        return told
