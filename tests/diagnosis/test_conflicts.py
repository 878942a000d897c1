"""Conflicts of robots, whose clauses are Horn and whose conflicts are made minimal by unit propagation."""

from __future__ import annotations

import random
from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pysat.solvers import Solver
from tests.diagnosis.netlists import circuit, observed_circuits
from tests.diagnosis.systems import systems

from robomend.diagnosis import justification
from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import Options
from robomend.errors import ContradictoryModel
from robomend.model.cnf import HealthCnf
from robomend_bench.generator import make_robot, observe
from robomend_client.literals import Literal


def consistent(cnf: HealthCnf, healthy: tuple[str, ...], seen: tuple[Literal, ...]) -> bool:
    with Solver("glucose4", bootstrap_with=cnf.clauses) as solver:
        numbers = [number for literal in seen if (number := cnf.literal(literal)) is not None]
        answer: bool = solver.solve([*(cnf.health[name] for name in healthy), *numbers])
        return answer


@pytest.mark.parametrize("minimal", ["cardinality", "subset"])
def test_conflicts_of_a_warm_engine_are_minimal_in_components_and_observations(minimal: str) -> None:
    robot = make_robot(25, 7)
    chance = random.Random(7)
    engine = make_engine("sat", robot.cnf)
    other = make_engine("hs_dag", robot.cnf)
    options = Options(minimal=minimal, limit=None)  # type: ignore[arg-type]  # a parameter is a str
    checked = 0
    for _ in range(25):
        seen = observe(robot, chance.randint(1, 4), chance)
        result = engine.diagnose(seen, options)
        assert {d.bad for d in result.diagnoses} == {d.bad for d in other.diagnose(seen, options).diagnoses}
        for conflict in result.conflicts:
            parts, rests = conflict.components, conflict.observations
            assert not consistent(robot.cnf, parts, rests)
            for name in parts:
                assert consistent(robot.cnf, tuple(part for part in parts if part != name), seen)
            for literal in rests:
                assert consistent(robot.cnf, parts, tuple(one for one in rests if one != literal))
            checked += 1
    assert checked > 25
    engine.close()
    other.close()


@pytest.mark.parametrize("minimal", ["cardinality", "subset"])
def test_each_gate_that_is_blamed_is_needed_by_a_conflict_or_it_is_said_that_some_are_missing(
    minimal: str,
) -> None:
    engine = make_engine("sat", circuit("c880").cnf)
    options = Options(minimal=minimal, max_size=2, limit=20)  # type: ignore[arg-type]  # a parameter is a str
    whole = 0
    for seed in range(12):
        result = engine.diagnose(circuit("c880").observe(2, seed), options)
        alone = [
            any(set(c.components) & set(diagnosis.bad) == {name} for c in result.conflicts)
            for diagnosis in result.diagnoses
            for name in diagnosis.bad
        ]
        assert all(alone) == result.conflicts_complete
        whole += result.conflicts_complete
    assert whole >= 10
    engine.close()


def minimal_conflicts(cnf: HealthCnf, seen: tuple[Literal, ...]) -> set[frozenset[str]]:
    """Return all of them by definition: each set of components, the smallest first."""
    found: set[frozenset[str]] = set()
    for size in range(len(cnf.components) + 1):
        for some in map(frozenset, combinations(cnf.components, size)):
            if not any(smaller <= some for smaller in found) and not consistent(cnf, tuple(some), seen):
                found.add(some)
    return found


@given(systems() | observed_circuits().map(lambda drawn: (drawn[0].cnf, drawn[1])), st.booleans())
def test_all_minimal_conflicts_are_told_where_they_are_asked_for(
    asked: tuple[HealthCnf, frozenset[Literal]], few: bool
) -> None:
    cnf, observations = asked
    seen = tuple(observations)
    with pytest.MonkeyPatch.context() as patch:
        if few:
            patch.setattr(justification, "MAX_OF_ALL", 1)
        engine = make_engine("sat", cnf)
        try:
            result = engine.diagnose(seen, Options(conflicts="all", limit=None, timeout_s=None))
        except ContradictoryModel:
            return
    everything = minimal_conflicts(cnf, seen)
    told = {frozenset(one.components) for one in result.conflicts}
    assert result.conflicts_all == (told == everything)
    assert told <= everything
    assert few or result.conflicts_all
    some = engine.diagnose(seen, Options(limit=None, timeout_s=None))
    if some.conflicts_all:
        assert {frozenset(one.components) for one in some.conflicts} == everything
    assert {d.bad for d in some.diagnoses} == {d.bad for d in result.diagnoses}
    engine.close()
