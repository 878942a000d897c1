"""Conflicts of robots, whose clauses are Horn and whose conflicts are made minimal by unit propagation."""

from __future__ import annotations

import random
from itertools import combinations
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pysat.solvers import Solver
from tests.diagnosis.netlists import circuit, observed_circuits
from tests.diagnosis.systems import systems

from robomend.diagnosis import justification
from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.observed import ObservationReader
from robomend.diagnosis.result import Conflict, Options
from robomend.errors import ContradictoryModel, OptionRefused
from robomend.model.cnf import HealthCnf
from robomend_bench.generator import make_robot, observe
from robomend_client.literals import Literal, fails, holds


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


def test_every_member_of_a_diagnosis_is_needed_by_a_reported_conflict() -> None:
    robot = make_robot(40, 3)
    chance = random.Random(3)
    engine = make_engine("sat", robot.cnf)
    for _ in range(20):
        result = engine.diagnose(observe(robot, 3, chance), Options(limit=50))
        for diagnosis in result.diagnoses:
            for name in diagnosis.bad:
                alone = [set(c.components) & set(diagnosis.bad) == {name} for c in result.conflicts]
                assert any(alone)
    engine.close()


def test_a_list_that_changed_since_the_last_call_is_read_anew() -> None:
    robot = make_robot(20, 1)
    topic = next(atom.args[0] for atom in robot.cnf.atoms if atom.predicate == "ok")
    engine = make_engine("sat", robot.cnf)
    seen = [holds("ok", topic)]
    assert engine.consistent(seen)
    seen.append(holds("nobody", "mentions", "me"))
    assert engine.consistent(seen)
    seen[0] = fails("ok", topic)
    assert not engine.consistent(seen)
    engine.close()


def test_equal_literals_are_read_alike_whatever_object_they_are() -> None:
    robot = make_robot(20, 1)
    seen = observe(robot, 1, random.Random(1))
    copies = tuple((holds if one.positive else fails)(one.atom.predicate, *one.atom.args) for one in seen)
    reader = ObservationReader(robot.cnf)
    first = reader.read(seen)
    assert reader.read(list(seen)) is first
    assert reader.read(copies).numbers == first.numbers
    assert reader.read(()).numbers == ()
    assert reader.read(seen[:1] + copies[1:-1] + seen[-1:]) is reader.read(seen)
    assert reader.read((*seen[:3], -seen[3], *seen[4:])).numbers[3] == -first.numbers[3]
    assert reader.read(iter(seen)).numbers == first.numbers
    with pytest.raises(ContradictoryModel):
        reader.read((*seen, -seen[0]))


def test_conflicts_of_circuits_are_minimal_or_said_not_to_be() -> None:
    cnf = circuit("c880").cnf
    engine = make_engine("sat", cnf)
    said = []
    for seed in range(5, 9):
        seen = circuit("c880").observe(3, seed)
        if seed == 6:  # from here on by simulation, before by the solver's cores
            engine.diagnose(seen, Options("cardinality", limit=2))
        result = engine.diagnose(seen, Options("cardinality", limit=1))
        assert result.conflicts
        for conflict in result.conflicts:
            assert not consistent(cnf, conflict.components, conflict.observations)
            needed = [
                consistent(cnf, tuple(c for c in conflict.components if c != name), tuple(seen))
                for name in conflict.components
            ]
            assert all(needed) or not conflict.minimal
            said.append(conflict.minimal)
    assert sum(said) > len(said) / 2
    engine.close()


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


def test_all_conflicts_of_a_large_circuit_are_as_many_as_there_is_time_and_room_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(justification, "MAX_OF_ALL", 3)
    seen = circuit("c880").observe(3, 5)
    engine = make_engine("sat", circuit("c880").cnf)
    result = engine.diagnose(seen, Options("cardinality", limit=1, conflicts="all", timeout_s=None))
    assert len({one.components for one in result.conflicts}) == 3
    assert not result.conflicts_all
    with pytest.raises(OptionRefused):
        engine.diagnose(seen, Options(conflicts="most"))  # type: ignore[arg-type]  # that is the point
    engine.close()


def test_when_there_is_no_time_for_conflicts_they_are_said_to_be_missing() -> None:
    seen = circuit("c880").observe(3, 5)
    engine: Any = make_engine("sat", circuit("c880").cnf)
    told = engine._answer

    def too_late(*arguments: Any) -> Any:
        engine.interrupt()
        return told(*arguments)

    engine._answer = too_late
    result = engine.diagnose(seen, Options("cardinality", limit=None))
    assert result.complete
    assert result.diagnoses
    assert not result.conflicts_complete
    engine.close()


def test_a_robots_conflicts_are_told_even_when_the_time_is_up() -> None:
    robot = make_robot(30, 2)
    seen = observe(robot, 3, random.Random(2))
    engine: Any = make_engine("sat", robot.cnf)
    expected = engine.diagnose(seen)
    told = engine._answer

    def too_late(*arguments: Any) -> Any:
        engine.interrupt()
        return told(*arguments)

    engine._answer = too_late
    assert engine.diagnose(seen).conflicts == expected.conflicts
    engine.close()


def test_what_was_told_before_is_told_as_by_a_new_engine() -> None:
    robot = make_robot(12, 5)
    chance = random.Random(5)
    warm = make_engine("sat", robot.cnf)
    again = 0
    met: set[Conflict] = set()
    for _ in range(40):
        seen = observe(robot, chance.randint(1, 2), chance)
        healthy = frozenset(chance.sample(robot.cnf.components, chance.randint(0, 2)))
        for options in (Options(), Options(healthy=healthy), Options()):
            fresh = make_engine("sat", robot.cnf)
            told = warm.diagnose(seen, options).conflicts
            assert told == fresh.diagnose(seen, options).conflicts
            fresh.close()
            again += len(met.intersection(told))
            met.update(told)
    assert again > 40
    warm.close()
