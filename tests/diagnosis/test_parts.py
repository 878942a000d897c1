"""Diagnoses put together of independent parts: which, how many, in which order, and as products."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

from hypothesis import given
from hypothesis import strategies as st
from tests.diagnosis.test_guided import families, minimal_hitting_sets

from robomend.diagnosis.core_guided import MinimumTooLarge
from robomend.diagnosis.masks import mask_of
from robomend.diagnosis.oracle import Deadline
from robomend.diagnosis.parts import (
    IndependentPart,
    independent,
    list_diagnoses,
    minimal,
)
from robomend.diagnosis.result import Options
from robomend.diagnosis.search import LimitReached, Row, SearchState


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
