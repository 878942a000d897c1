"""Regions of a model that say nothing of one another."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from tests.diagnosis.systems import brute_force, model, systems

from robomend.diagnosis import by_conflicts
from robomend.diagnosis.by_conflicts import regions
from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.masks import members
from robomend.diagnosis.result import Options
from robomend.model.cnf import Clause, HealthCnf
from robomend_client.literals import Literal, fails

# components 1-4, atoms 5-9
SYSTEM = model(4, [(-1, 5, 6), (-2, -7, 8), (-3, -7, 9), (-4, 7)], atoms=5)


def found(implied: list[int]) -> set[tuple[int, ...]]:
    return {members(mask) for mask in regions(SYSTEM, implied, ())}


def test_what_was_seen_takes_clauses_apart() -> None:
    assert found([-5, -6, -8, -9]) == {(1,), (2, 3, 4)}
    assert found([-5, -6, -8, -9, 7]) == {(1,), (2,), (3,)}


def test_what_nobody_looks_at_is_no_region() -> None:
    assert found([-5, -6]) == {(1,)}  # 8 and 9 may hold, so that 7 does not matter either


def test_a_component_that_must_be_abnormal_is_a_region_of_its_own() -> None:
    assert found([-5, -6, -1]) == {(1,)}
    assert regions(SYSTEM, [-5, -6, -1], frozenset({1})) == []


def test_independent_faults_under_rules_that_are_not_horn_are_counted_exactly() -> None:
    count = 30
    clauses: list[Clause] = [
        (-(2 * i + 1), -(2 * i + 2), 2 * count + 2 * i + 1, 2 * count + 2 * i + 2) for i in range(count)
    ]
    cnf = model(2 * count, clauses, atoms=2 * count)
    result = make_engine("sat", cnf).diagnose([fails("ok", atom.args[0]) for atom in cnf.atoms])
    assert result.count == 2**count
    assert [len(row) for row in result.factored] == [count]
    assert len(result.diagnoses) == 100


@pytest.mark.parametrize("nodes", [0, 3, 20])
@settings(deadline=None)
@given(systems())
def test_another_search_goes_on_from_what_was_found(
    nodes: int, system: tuple[HealthCnf, frozenset[Literal]]
) -> None:
    cnf, seen = system
    expected = brute_force(cnf, seen)
    if expected is None:
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(by_conflicts, "SEARCHED_NODES", nodes)
        result = make_engine("sat", cnf).diagnose(seen, Options(limit=None, timeout_s=None))
    assert {diagnosis.bad for diagnosis in result.diagnoses} == expected
    assert result.complete
