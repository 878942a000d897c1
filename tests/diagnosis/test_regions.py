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
from robomend.model.cnf import HealthCnf
from robomend_client.literals import Literal

# components 1-4, atoms 5-9
SYSTEM = model(4, [(-1, 5, 6), (-2, -7, 8), (-3, -7, 9), (-4, 7)], atoms=5)


def found(implied: list[int]) -> set[tuple[int, ...]]:
    return {members(mask) for mask in regions(SYSTEM, implied, ())}


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
