"""The sat engine against Reiter's definition, and against itself."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.diagnosis.netlists import circuit
from tests.diagnosis.systems import brute_force, model, systems

from robomend.diagnosis.engines import ENGINES, make_engine
from robomend.diagnosis.observed import KEPT_UNUSED, ObservationReader
from robomend.diagnosis.result import Options
from robomend.diagnosis.snapshots import diagnose_snapshots
from robomend.errors import ContradictoryModel
from robomend.model.cnf import HealthCnf
from robomend_client.literals import Literal, fails, holds


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


def test_of_a_supposition_that_cannot_be_only_what_refutes_it_is_told() -> None:
    cnf = model(2, [(-1, 3), (-2, 4)], atoms=2)
    seen, supposed = [fails("ok", "a1"), fails("ok", "a2")], Options(healthy=frozenset({"c2"}))
    for result in (
        *(make_engine(name, cnf).diagnose(seen, supposed) for name in ENGINES.built_in),
        diagnose_snapshots(cnf, [seen], supposed),
    ):
        assert (result.diagnoses, result.complete) == ((), True)
        (conflict,) = result.conflicts
        assert conflict.unmet in (None, fails("ok", "a2"))
        assert conflict.text.startswith("a2 should be ok because c2 is ")


def test_where_a_supposition_cannot_be_no_larger_diagnosis_is_promised() -> None:
    cnf = circuit("c17").cnf
    engine = make_engine("sat", cnf)
    seen = [holds("v", "1"), holds("v", "3"), holds("v", "10")]  # 10 is their NAND
    supposed = frozenset({"10"}), frozenset({"22"})
    for size in (0, 1, None):
        options = Options(minimal="cardinality", max_size=size, healthy=supposed[0], abnormal=supposed[1])
        result = engine.diagnose(seen, options)
        assert (result.diagnoses, result.stopped_by) == ((), None)
    assert engine.diagnose(seen, Options(minimal="cardinality", max_size=0)).stopped_by == "size"


# --- observations in the solver's numbers

CNF = model(1, [(-1, 2)], atoms=3)


def test_what_no_rule_mentions_is_told_once_and_refused_where_it_clashes() -> None:
    reader = ObservationReader(CNF)
    stranger = holds("ok", "stranger")
    for _ in range(2):  # new, then met before
        observed = reader.read([stranger, fails("ok", "a2"), stranger])
        assert observed.unused == (stranger,)
        assert observed.numbers == (-3,)
        assert observed.seen == {-3}
        with pytest.raises(ContradictoryModel):
            reader.read([stranger, fails("ok", "a2"), -stranger])


def test_strangers_do_not_fill_the_memory() -> None:
    reader = ObservationReader(CNF)
    reader.read([holds("ok", "a1"), *(holds("ok", f"stranger{number}") for number in range(3 * KEPT_UNUSED))])
    assert reader.read([holds("ok", "a1"), fails("ok", "a2")]).numbers == (2, -3)
    assert len(reader.known) < 2 * KEPT_UNUSED
