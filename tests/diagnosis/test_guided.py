"""Hitting sets of growing families: complete, minimal, and in order of cost."""

from __future__ import annotations

from itertools import combinations

from hypothesis import given
from hypothesis import strategies as st

from robomend.diagnosis.guided import AnyHittingSets, CheapestHittingSets
from robomend.diagnosis.masks import bits
from robomend.diagnosis.oracle import Deadline

COMPONENTS = 7

families = st.lists(st.integers(1, 2**COMPONENTS - 1), min_size=1, max_size=9)
weights = st.lists(st.integers(0, 6), min_size=COMPONENTS, max_size=COMPONENTS)


def minimal_hitting_sets(family: list[int]) -> set[int]:
    """Return them by definition."""
    found: list[int] = []
    for size in range(COMPONENTS + 1):
        for chosen in combinations(range(COMPONENTS), size):
            mask = sum(1 << bit for bit in chosen)
            if all(mask & conflict for conflict in family) and not any(mask & m == m for m in found):
                found.append(mask)
    return set(found)


def enumerate_all(sets: AnyHittingSets | CheapestHittingSets, family: list[int]) -> list[int]:
    """Reveal the family one conflict at a time, as an implicit hitting set search does."""
    found = []
    while (candidate := sets.next()) is not None:
        missed = next((conflict for conflict in family if not conflict & candidate), None)
        if missed is None:
            found.append(candidate)
            sets.block(candidate)
        else:
            sets.hit(missed)
    sets.close()
    return found


@given(families)
def test_any_order_finds_each_minimal_hitting_set_once(family: list[int]) -> None:
    found = enumerate_all(AnyHittingSets(Deadline()), family)
    assert len(found) == len(set(found))
    assert set(found) == minimal_hitting_sets(family)


@given(families, weights)
def test_cheapest_first_finds_each_once_in_order_of_cost(family: list[int], weights: list[int]) -> None:
    found = enumerate_all(CheapestHittingSets(weights, Deadline()), family)
    assert len(found) == len(set(found))
    assert set(found) == minimal_hitting_sets(family)
    costs = [sum(weights[bit] for bit in bits(mask)) for mask in found]
    assert costs == sorted(costs)
