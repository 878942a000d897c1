"""The core-guided search: smallest hitting sets of made-up conflicts, with and without an incumbent."""

from __future__ import annotations

from itertools import combinations

from hypothesis import given
from hypothesis import strategies as st

from robomend.diagnosis.core_guided import CoreGuided
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
