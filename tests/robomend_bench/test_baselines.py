"""The baselines answer the same questions as the engines, by other means."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from tests.diagnosis.systems import brute_force, systems

from robomend.model.cnf import HealthCnf
from robomend_bench.baselines import BASELINES
from robomend_client.literals import Literal


@pytest.mark.parametrize("name", BASELINES)
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
