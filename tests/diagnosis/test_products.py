"""Diagnoses that are multiplied out of their parts come in order, and whole."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

from hypothesis import given
from hypothesis import strategies as st

from robomend.diagnosis.library import Products
from robomend.diagnosis.masks import bits, mask_of
from robomend.diagnosis.oracle import Deadline
from robomend.diagnosis.parts import IndependentPart
from robomend.diagnosis.search import by_size


def searched(*parts: Sequence[int]) -> dict[tuple[int, ...], IndependentPart]:
    """Return the parts of these conflicts, searched to their ends."""
    found = {tuple(conflicts): IndependentPart.of(conflicts, Deadline()) for conflicts in parts}
    for part in found.values():
        part.extend(1000, None)
    return found


@st.composite
def disjoint_parts(draw: st.DrawFn) -> tuple[int, list[list[int]]]:
    """Draw a number of components, and the conflicts of up to four parts that share none of them."""
    count = draw(st.sampled_from([1, 7, 12, 13, 30, 70]))
    whose = draw(st.lists(st.integers(0, 4), min_size=count, max_size=count))
    found = []
    for part in range(4):
        mine = [component for component, of in enumerate(whose) if of == part][:4]
        if not mine:
            continue
        first = mine[0]
        conflicts = [mask_of({first + 1, other + 1}) for other in mine[1:]] or [1 << first]
        found.append(sorted(conflicts))
    return count, found


@given(disjoint_parts())
def test_they_are_all_unions_of_one_alternative_of_each_part_in_the_order_of_size_and_components(
    drawn: tuple[int, list[list[int]]],
) -> None:
    count, parts = drawn
    names = [f"c{number}" for number in range(count)]
    known = searched(*parts)
    found = Products(names, 1000).of([reversed(conflicts) for conflicts in parts], known)
    every = [sum(one) for one in product(*(part.listed() for part in known.values()))]
    expected = sorted((tuple(bits(mask)) for mask in every), key=by_size)
    assert found == [tuple(names[component] for component in bad) for bad in expected]
