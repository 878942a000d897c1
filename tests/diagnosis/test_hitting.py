"""Hitting sets by size over bit masks, against their definition: each once, and what is said of the rest."""

from __future__ import annotations

from collections.abc import Callable

from hypothesis import given
from tests.diagnosis.test_guided import COMPONENTS, families, minimal_hitting_sets

from robomend.diagnosis.hitting import HittingSets


def revealing(family: list[int]) -> Callable[[int], int | None]:
    """Return the question that the search asks, answered with the first conflict that is not hit."""
    return lambda mask: next((conflict for conflict in family if not conflict & mask), None)


def by_size(search: HittingSets) -> dict[int, list[int]]:
    """Return what is found at each size that is asked for, until the search says that there is no more."""
    found: dict[int, list[int]] = {}
    size = 0
    while not found or not search.exhausted:
        found[size] = list(search.of_size(size))
        size = max(size + 1, search.next_size)
        assert size <= COMPONENTS + 1
    return found


@given(families)
def test_each_minimal_hitting_set_is_found_once_at_its_size(family: list[int]) -> None:
    found = by_size(HittingSets(revealing(family)))
    listed = [mask for masks in found.values() for mask in masks]
    assert sorted(listed) == sorted(minimal_hitting_sets(family))
    assert all(mask.bit_count() == size for size, masks in found.items() for mask in masks)
