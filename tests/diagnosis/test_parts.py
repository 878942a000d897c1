"""Diagnoses put together of independent parts: which, how many, in which order, and as products."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice, product

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.diagnosis.test_guided import families, minimal_hitting_sets

from robomend.diagnosis.core_guided import MinimumTooLarge
from robomend.diagnosis.masks import classes_of, mask_of
from robomend.diagnosis.oracle import Deadline, OutOfTime
from robomend.diagnosis.parts import (
    IndependentPart,
    independent,
    list_diagnoses,
    minimal,
    smallest,
)
from robomend.diagnosis.result import Minimal, Options
from robomend.diagnosis.search import LimitReached, Row, SearchState

A, B, C, D, E = (1 << i for i in range(5))


def parts_of(family: Sequence[int]) -> list[IndependentPart]:
    return [IndependentPart.of(minimal(group), Deadline()) for group in independent(family)]


def listed(
    family: Sequence[int], *, limit: int = 1_000, max_size: int | None = None, minimal: Minimal = "subset"
) -> SearchState:
    answer = SearchState(limit, Deadline())
    options = Options(limit=limit, max_size=max_size, minimal=minimal)
    list_diagnoses(parts_of(family), 0, options, answer, counted=1_000)
    return answer


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


@given(families)
def test_components_of_one_class_are_in_the_same_conflicts(family: list[int]) -> None:
    classes = classes_of(family)
    everything = 0
    for conflict in family:
        everything |= conflict
    assert sum(classes) == everything
    signature = {
        bit: tuple(conflict >> bit & 1 for conflict in family) for bit in range(8) if everything >> bit & 1
    }
    for one in classes:
        inside = {signature[bit] for bit in signature if one >> bit & 1}
        assert len(inside) == 1
    assert len(classes) == len(set(signature.values()))


def test_the_clock_ends_telling_classes_apart() -> None:
    stopped = Deadline()
    stopped.stop()
    with pytest.raises(OutOfTime):
        IndependentPart.of([A | B, B | C], stopped)


@given(families, st.integers(2, 12))
def test_the_first_few_are_the_smallest_and_the_rest_is_counted(family: list[int], limit: int) -> None:
    expected = minimal_hitting_sets(family)
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
    expected = minimal_hitting_sets(family)
    small = {mask for mask in expected if mask.bit_count() <= max_size}
    answer = SearchState(1_000, Deadline())
    options = Options(limit=1_000, max_size=max_size)
    try:
        list_diagnoses(parts_of(family), 0, options, answer, counted=1_000)
        assert small == expected
    except MinimumTooLarge:
        assert small < expected
    assert {mask_of(bad) for bad in answer.found} == small


@given(families)
def test_minimum_cardinality_takes_the_smallest_of_each_part(family: list[int]) -> None:
    expected = minimal_hitting_sets(family)
    least = min(mask.bit_count() for mask in expected)
    found = [mask_of(bad) for bad in listed(family, minimal="cardinality").found]
    assert sorted(found) == sorted(mask for mask in expected if mask.bit_count() == least)


@given(families, st.lists(st.integers(1, 9), min_size=8, max_size=8))
def test_any_cost_that_is_a_sum_gives_the_order(family: list[int], costs: list[int]) -> None:
    def cost(mask: int) -> float:
        return sum(costs[bit] for bit in range(8) if mask >> bit & 1)

    parts = parts_of(family)
    for part in parts:
        part.extend(1_000, None)
    order = list(smallest(parts, 1_000, cost))
    assert sorted(order) == sorted(minimal_hitting_sets(family))
    assert [cost(mask) for mask in order] == sorted(map(cost, order))
    first = list(islice(smallest(parts, 3, cost), 9))
    assert [cost(mask) for mask in first] == [cost(mask) for mask in order[:3]]


@given(families)
def test_where_the_search_has_too_many_nodes_another_goes_on(family: list[int]) -> None:
    parts = parts_of(family)
    for part in parts:
        if part.search is not None:
            part.search._budget = 2  # so that hardly anything is found by it
    answer = SearchState(1_000, Deadline())
    list_diagnoses(parts, 0, Options(limit=1_000), answer, counted=1_000)
    assert sorted(map(mask_of, answer.found)) == sorted(minimal_hitting_sets(family))


def test_alternatives_of_several_components_are_kept_together() -> None:
    answer = SearchState(2, Deadline())
    with pytest.raises(LimitReached):  # {a} or {b, c}, and d or e
        list_diagnoses(parts_of([A | B, A | C, D | E]), 0, Options(limit=2), answer, counted=10)
    assert answer.rows == [(((1,), (2, 3)), ((4,), (5,)))]
    assert answer.count == 4


def test_what_was_found_when_the_time_runs_out_is_handed_on() -> None:
    clock = Deadline()
    parts = [IndependentPart.of([A | B, B | C], clock), IndependentPart.of([D | E], clock)]
    answer = SearchState(100, Deadline())

    def check() -> None:
        raise OutOfTime

    for part in parts:
        part.extend(1, None)
        if part.search is not None:
            part.search._check = check
            part.search._nodes = 1_000  # so that it looks at the clock at once
    with pytest.raises(OutOfTime):
        list_diagnoses(parts, 0, Options(), answer, counted=10)
    assert sorted(map(mask_of, answer.found)) == [B | D, B | E]
