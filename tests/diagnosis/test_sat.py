"""The sat engine against Reiter's definition, and against itself."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.diagnosis.systems import brute_force, model, systems

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import Options
from robomend.errors import ContradictoryModel
from robomend.model.cnf import HealthCnf
from robomend_client.literals import Literal, fails, holds

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


@given(systems(), st.data())
def test_a_check_does_not_depend_on_the_checks_before(
    system: tuple[HealthCnf, frozenset[Literal]], data: st.DataObject
) -> None:
    cnf, observations = system
    engine = make_engine("sat", cnf)
    signs = st.dictionaries(st.sampled_from(cnf.atoms), st.booleans())
    others = data.draw(st.lists(signs, max_size=6))
    for seen in [observations, *(frozenset(Literal(*pair) for pair in other.items()) for other in others)]:
        expected = brute_force(cnf, seen)
        assert engine.consistent(seen) == (expected is not None and () in expected)
    engine.close()


def test_a_check_refuses_a_literal_and_its_opposite_whatever_was_checked_before() -> None:
    engine = make_engine("sat", model(1, [(-1, 2)]))
    seen = [holds("ok", "a1"), holds("ok", "a2")]
    for _ in range(2):
        assert engine.consistent(seen)
        for clash in (fails("ok", "a2"), fails("ok", "a1")):
            with pytest.raises(ContradictoryModel):
                engine.consistent([*seen, clash])
        with pytest.raises(ContradictoryModel):
            engine.consistent([*seen, holds("nobody", "mentions"), fails("nobody", "mentions")])
        assert engine.consistent([*seen, holds("nobody", "mentions")])
    engine.close()
