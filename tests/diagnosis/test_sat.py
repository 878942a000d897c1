"""The sat engine against Reiter's definition, and against itself."""

from __future__ import annotations

import pytest
from hypothesis import given
from tests.diagnosis.systems import brute_force, systems

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import Options
from robomend.errors import ContradictoryModel
from robomend.model.cnf import HealthCnf
from robomend_client.literals import Literal

ALL = Options(limit=None, timeout_s=None)


@given(systems())
def test_subset_minimal_diagnoses_are_those_of_the_definition(
    system: tuple[HealthCnf, frozenset[Literal]],
) -> None:
    cnf, observations = system
    expected = brute_force(cnf, observations)
    engine = make_engine("sat", cnf)
    if expected is None:
        with pytest.raises(ContradictoryModel):
            engine.diagnose(observations, ALL)
        return
    result = engine.diagnose(observations, ALL)
    assert {diagnosis.bad for diagnosis in result.diagnoses} == expected
    assert result.complete
    sizes = [len(diagnosis.bad) for diagnosis in result.diagnoses]
    assert sizes == sorted(sizes)
    assert engine.consistent(observations) == (() in expected)
