"""Hitting sets by each search, against their definition: complete, minimal, in order, and as products."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations, product

from hypothesis import given
from hypothesis import strategies as st

from robomend.diagnosis.core_guided import CoreGuided, MinimumTooLarge
from robomend.diagnosis.guided import AnyHittingSets, CheapestHittingSets
from robomend.diagnosis.hitting import HittingSets
from robomend.diagnosis.library import Products
from robomend.diagnosis.masks import bits, mask_of
from robomend.diagnosis.oracle import Deadline
from robomend.diagnosis.parts import (
    IndependentPart,
    independent,
    list_diagnoses,
    minimal,
)
from robomend.diagnosis.result import Options
from robomend.diagnosis.search import LimitReached, Row, SearchState, by_size

COMPONENTS = 7

families = st.lists(st.integers(1, 2**COMPONENTS - 1), min_size=1, max_size=9)
weights = st.lists(st.integers(0, 6), min_size=COMPONENTS, max_size=COMPONENTS)


def minimal_hitting_sets(family: list[int]) -> list[int]:
    """Return them by definition, the smallest first."""
    found: list[int] = []
    for size in range(COMPONENTS + 1):
        for chosen in combinations(range(COMPONENTS), size):
            mask = sum(1 << bit for bit in chosen)
            if all(mask & conflict for conflict in family) and not any(mask & m == m for m in found):
                found.append(mask)
    return found


# --- revealed one conflict at a time, as an implicit hitting set search does


def enumerate_all(sets: AnyHittingSets | CheapestHittingSets, family: list[int]) -> list[int]:
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
    assert sorted(found) == sorted(minimal_hitting_sets(family))


@given(families, weights)
def test_cheapest_first_finds_each_once_in_order_of_cost(family: list[int], weights: list[int]) -> None:
    found = enumerate_all(CheapestHittingSets(weights, Deadline()), family)
    assert sorted(found) == sorted(minimal_hitting_sets(family))
    costs = [sum(weights[bit] for bit in bits(mask)) for mask in found]
    assert costs == sorted(costs)


def revealing(family: list[int]) -> Callable[[int], int | None]:
    """Return the question that the search asks, answered with the first conflict that is not hit."""
    return lambda mask: next((conflict for conflict in family if not conflict & mask), None)


@given(families)
def test_each_minimal_hitting_set_is_found_once_at_its_size(family: list[int]) -> None:
    search, found, size = HittingSets(revealing(family)), dict[int, list[int]](), 0
    while not found or not search.exhausted:
        found[size] = list(search.of_size(size))
        size = max(size + 1, search.next_size)
        assert size <= COMPONENTS + 1
    listed = [mask for masks in found.values() for mask in masks]
    assert sorted(listed) == sorted(minimal_hitting_sets(family))
    assert all(mask.bit_count() == size for size, masks in found.items() for mask in masks)


# --- the smallest, guided by cores


def searched(family: list[int]) -> CoreGuided:
    clauses = [[-(bit + 1) for bit in bits(conflict)] for conflict in family]
    return CoreGuided(clauses, COMPONENTS, COMPONENTS, Deadline(), "minisat22")


def smallest(family: list[int]) -> list[list[int]]:
    masks = minimal_hitting_sets(family)
    least = [mask for mask in masks if mask.bit_count() == masks[0].bit_count()]
    return sorted([bit + 1 for bit in bits(mask)] for mask in least)


@given(families)
def test_all_of_the_least_size_are_found(family: list[int]) -> None:
    assert sorted(sorted(found) for found in searched(family).minimum([])) == smallest(family)


@given(families, st.data())
def test_whatever_the_incumbent_the_first_is_a_smallest_one(family: list[int], data: st.DataObject) -> None:
    least = smallest(family)
    more = data.draw(st.sets(st.integers(1, COMPONENTS)))
    search = searched(family)
    some = sorted({*data.draw(st.sampled_from(least)), *more})
    for incumbent in (some, list(range(1, COMPONENTS + 1)), None):
        assert sorted(next(search.minimum([], incumbent=incumbent))) in least


# --- put together of independent parts


def parts_of(family: Sequence[int]) -> list[IndependentPart]:
    return [IndependentPart.of(minimal(group), Deadline()) for group in independent(family)]


def expanded(rows: Sequence[Row]) -> list[int]:
    return [mask_of(v for bad in choice for v in bad) for row in rows for choice in product(*row)]


@given(families)
def test_groups_hold_all_conflicts_and_share_nothing(family: list[int]) -> None:
    groups = independent(family)
    assert sorted(conflict for group in groups for conflict in group) == sorted(family)
    masks = [0] * len(groups)
    for index, group in enumerate(groups):
        for conflict in group:
            masks[index] |= conflict
    assert sum(masks) == sum({1 << bit for bit in range(8) for mask in masks if mask >> bit & 1})


@given(families, st.integers(2, 12))
def test_the_first_few_are_the_smallest_and_the_rest_is_counted(family: list[int], limit: int) -> None:
    expected = set(minimal_hitting_sets(family))
    answer = SearchState(limit, Deadline())
    more = len(expected) > limit
    try:
        list_diagnoses(parts_of(family), 0, Options(limit=limit), answer, counted=1_000)
    except LimitReached:
        assert more
    found = [mask_of(bad) for bad in answer.found]
    assert set(found) <= expected
    assert len(set(found)) == len(found) == min(limit, len(expected))
    sizes = sorted(mask.bit_count() for mask in expected)
    assert sorted(mask.bit_count() for mask in found) == sizes[: len(found)]
    assert answer.count == len(expected)
    if more:
        products = expanded(answer.rows)
        assert len(products) == len(set(products))
        assert set(products) == expected


@given(families, st.integers(0, 7))
def test_a_bound_on_the_size_leaves_out_what_is_larger_and_says_so(family: list[int], max_size: int) -> None:
    expected = set(minimal_hitting_sets(family))
    small = {mask for mask in expected if mask.bit_count() <= max_size}
    answer = SearchState(1_000, Deadline())
    options = Options(limit=1_000, max_size=max_size)
    try:
        list_diagnoses(parts_of(family), 0, options, answer, counted=1_000)
        assert small == expected
    except MinimumTooLarge:
        assert small < expected
    assert {mask_of(bad) for bad in answer.found} == small


# --- multiplied out of their parts


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
    known = {tuple(conflicts): IndependentPart.of(conflicts, Deadline()) for conflicts in parts}
    for part in known.values():
        part.extend(1000, None)
    found = Products(names, 1000).of([reversed(conflicts) for conflicts in parts], known)
    every = [sum(one) for one in product(*(part.listed() for part in known.values()))]
    expected = sorted((tuple(bits(mask)) for mask in every), key=by_size)
    assert found == [tuple(names[component] for component in bad) for bad in expected]
