"""The baselines answer the same questions as the engines, by other means."""

from __future__ import annotations

from itertools import combinations

import pytest
from hypothesis import given, settings
from tests.diagnosis.systems import brute_force, systems

from robomend.model.cnf import HealthCnf
from robomend_bench.baselines import BASELINES
from robomend_client.literals import Literal

CONFLICTS = ("marco", "optux")


@pytest.mark.parametrize("name", CONFLICTS)
@settings(deadline=None, max_examples=40)
@given(drawn=systems())
def test_all_minimal_conflicts_are_those_that_the_minimal_diagnoses_hit(
    name: str, drawn: tuple[HealthCnf, frozenset[Literal]]
) -> None:
    cnf, seen = drawn
    expected = brute_force(cnf, seen)
    if expected is None or not cnf.weak:
        return
    found = [frozenset(one) for one in BASELINES[name](cnf).diagnoses(seen, "conflicts", 0)]
    named = [{cnf.components[variable - 1] for variable in one} for one in found]
    hitting = {
        frozenset(some)
        for size in range(len(cnf.components) + 1)
        for some in combinations(cnf.components, size)
        if all(one & set(some) for one in named)
    }
    minimal = {one for one in hitting if not any(other < one for other in hitting)}
    assert minimal == set(map(frozenset, expected))
    assert not any(one < other for one in found for other in found)


@pytest.mark.parametrize("name", [name for name in BASELINES if name not in CONFLICTS])
@settings(deadline=None, max_examples=40)
@given(drawn=systems())
def test_minimum_cardinality_agrees_with_the_definition(
    name: str, drawn: tuple[HealthCnf, frozenset[Literal]]
) -> None:
    cnf, seen = drawn
    expected = brute_force(cnf, seen)
    if expected is None:
        return
    least = min(map(len, expected))
    baseline = BASELINES[name](cnf)
    found = [tuple(cnf.components[v - 1] for v in bad) for bad in baseline.diagnoses(seen, "all", 0)]
    assert len(found) == len(set(found))
    assert {tuple(sorted(bad)) for bad in found} == {bad for bad in expected if len(bad) == least}
    first = list(baseline.diagnoses(seen, "first", 0))
    assert len(first[0]) == least
    assert len(first) == 1


@pytest.mark.parametrize("name", ["layered-full", "clingo-domain"])
@settings(deadline=None, max_examples=40)
@given(drawn=systems())
def test_subset_minimal_up_to_a_size_agrees_with_the_definition(
    name: str, drawn: tuple[HealthCnf, frozenset[Literal]]
) -> None:
    cnf, seen = drawn
    expected = brute_force(cnf, seen)
    if expected is None:
        return
    baseline = BASELINES[name](cnf)
    for size in (1, 2):
        answers = baseline.diagnoses(seen, "subset", size)
        found = [tuple(cnf.components[v - 1] for v in bad) for bad in answers]
        assert len(found) == len(set(found))
        assert {tuple(sorted(bad)) for bad in found} == {bad for bad in expected if len(bad) <= size}
