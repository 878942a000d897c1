"""The core-guided search: smallest hitting sets of made-up conflicts, with and without an incumbent."""

from __future__ import annotations

from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend.diagnosis import core_guided
from robomend.diagnosis.core_guided import CoreGuided, MinimumTooLarge
from robomend.diagnosis.oracle import Deadline

CANDIDATES = 8
conflicts = st.lists(
    st.sets(st.integers(1, CANDIDATES), min_size=1, max_size=CANDIDATES).map(frozenset),
    min_size=1,
    max_size=10,
)


def searched(family: list[frozenset[int]]) -> CoreGuided:
    clauses = [[-candidate for candidate in sorted(conflict)] for conflict in family]
    return CoreGuided(clauses, CANDIDATES, CANDIDATES, Deadline(), "minisat22")


def smallest(family: list[frozenset[int]]) -> set[frozenset[int]]:
    for size in range(CANDIDATES + 1):
        sets = map(frozenset, combinations(range(1, CANDIDATES + 1), size))
        found = {chosen for chosen in sets if all(chosen & conflict for conflict in family)}
        if found:
            return found
    raise AssertionError("every family of conflicts has a hitting set")


@given(conflicts)
def test_all_of_the_least_size_are_found(family: list[frozenset[int]]) -> None:
    found = list(map(frozenset, searched(family).minimum([])))
    assert len(found) == len(set(found))
    assert set(found) == smallest(family)


@given(conflicts, st.data())
def test_whatever_the_incumbent_the_first_is_a_smallest_one(
    family: list[frozenset[int]], data: st.DataObject
) -> None:
    least = smallest(family)
    core = data.draw(st.sampled_from(sorted(least, key=sorted)))
    more = data.draw(st.sets(st.integers(1, CANDIDATES)))
    search = searched(family)
    for incumbent in (sorted(core | more), list(range(1, CANDIDATES + 1)), None):
        first = next(search.minimum([], incumbent=incumbent))
        assert frozenset(first) in least


@given(st.lists(conflicts, min_size=2, max_size=4), st.integers(1, 3))
def test_what_a_search_leaves_behind_does_not_change_the_next(
    families: list[list[frozenset[int]]], dropped_together: int
) -> None:
    search, selectors = selected(families)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(core_guided, "DROPPED_TOGETHER", dropped_together)
        for selector, family in zip(selectors, families, strict=True):
            assert set(map(frozenset, search.minimum([selector]))) == smallest(family)


def selected(families: list[list[frozenset[int]]]) -> tuple[CoreGuided, list[int]]:
    """Return a search over all of them, and of each the literal that makes it count."""
    selectors = list(range(CANDIDATES + 1, CANDIDATES + 1 + len(families)))
    clauses = [
        [-selector, *(-candidate for candidate in sorted(conflict))]
        for selector, family in zip(selectors, families, strict=True)
        for conflict in family
    ]
    return CoreGuided(clauses, CANDIDATES, selectors[-1], Deadline(), "minisat22"), selectors


def test_an_incumbent_that_is_too_large_for_what_is_asked_is_not_told() -> None:
    family = [frozenset({1}), frozenset({2}), frozenset({3})]
    with pytest.raises(MinimumTooLarge):
        next(searched(family).minimum([], at_most=2, incumbent=[1, 2, 3]))


@given(conflicts, st.data())
def test_cores_that_are_known_change_nothing_but_what_is_asked(
    family: list[frozenset[int]], data: st.DataObject
) -> None:
    least = smallest(family)
    known = data.draw(st.lists(st.sampled_from(family)))
    told = [sorted(core) for core in known]
    assert set(map(frozenset, searched(family).minimum([], cores=told))) == least
    incumbent = sorted(set().union(*known) | data.draw(st.sampled_from(sorted(least, key=sorted))))
    assert frozenset(next(searched(family).minimum([], incumbent=incumbent, cores=told))) in least
    with pytest.raises(MinimumTooLarge):
        list(searched(family).minimum([], at_most=len(next(iter(least))) - 1, cores=told))
