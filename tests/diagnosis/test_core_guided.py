"""The core-guided search: smallest hitting sets of made-up conflicts, with and without an incumbent."""

from __future__ import annotations

from itertools import combinations, zip_longest

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend.diagnosis import core_guided
from robomend.diagnosis.core_guided import CoreGuided, MinimumTooLarge
from robomend.diagnosis.oracle import Deadline, Oracle

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


def test_an_incumbent_of_the_least_size_is_the_answer() -> None:
    family = [frozenset({1, 2, 3}), frozenset({3, 4}), frozenset({5, 6})]
    assert list(searched(family).minimum([], incumbent=[3, 6])) == [[3, 6]]


@given(st.lists(conflicts, min_size=2, max_size=4), st.integers(1, 3))
def test_what_a_search_leaves_behind_does_not_change_the_next(
    families: list[list[frozenset[int]]], dropped_together: int
) -> None:
    search, selectors = selected(families)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(core_guided, "DROPPED_TOGETHER", dropped_together)
        for selector, family in zip(selectors, families, strict=True):
            assert set(map(frozenset, search.minimum([selector]))) == smallest(family)


def test_a_search_that_ends_after_its_solver_was_closed_leaves_nothing_in_the_next(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(core_guided, "DROPPED_TOGETHER", 2)
    overlapping = [frozenset(pair) for pair in combinations(range(1, CANDIDATES + 1), 2)]
    search = searched(overlapping)
    first = search.minimum([])
    next(first)
    search.close()
    second = search.minimum([])
    found = {frozenset(next(second))}
    first.close()
    next(search.minimum([]))
    assert found | set(map(frozenset, second)) == smallest(overlapping)


def selected(families: list[list[frozenset[int]]]) -> tuple[CoreGuided, list[int]]:
    """Return a search over all of them, and of each the literal that makes it count."""
    selectors = list(range(CANDIDATES + 1, CANDIDATES + 1 + len(families)))
    clauses = [
        [-selector, *(-candidate for candidate in sorted(conflict))]
        for selector, family in zip(selectors, families, strict=True)
        for conflict in family
    ]
    return CoreGuided(clauses, CANDIDATES, selectors[-1], Deadline(), "minisat22"), selectors


@given(conflicts, conflicts)
def test_searches_that_take_turns_do_not_disturb_one_another(
    one: list[frozenset[int]], other: list[frozenset[int]]
) -> None:
    search, selectors = selected([one, other])
    running = [search.minimum([selector]) for selector in selectors]
    found: list[list[frozenset[int]]] = [[], []]
    for answers in zip_longest(*running):
        for listed, answer in zip(found, answers, strict=True):
            if answer is not None:
                listed.append(frozenset(answer))
    assert [set(listed) for listed in found] == [smallest(one), smallest(other)]
    assert [len(listed) for listed in found] == [len(smallest(one)), len(smallest(other))]


def test_a_search_leaves_one_variable_behind_and_the_solver_is_built_anew_before_they_are_many(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    overlapping = [frozenset(pair) for pair in combinations(range(1, CANDIDATES + 1), 2)]
    search = searched(overlapping)

    def fresh_after_a_search() -> int:
        next(search.minimum([]))
        return search.new_guard()

    first = fresh_after_a_search()
    assert [fresh_after_a_search() - first for _ in range(3)] == [2, 4, 6]  # its guard, and the one to look
    monkeypatch.setattr(core_guided, "RESET_SEARCHES", 5)
    assert fresh_after_a_search() == first


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


def test_where_known_cores_pay_for_the_incumbent_nothing_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    family = [frozenset({1, 2}), frozenset({2, 3}), frozenset({4, 5}), frozenset({6})]
    search = searched(family)
    asked: list[None] = []
    monkeypatch.setattr(Oracle, "quickly", lambda *_: asked.append(None))
    cores = [[6], [1, 2], [2, 3], [4, 5]]  # the third shares a member with the second
    assert list(search.minimum([], incumbent=[2, 4, 6], cores=cores)) == [[2, 4, 6]]
    assert not asked
