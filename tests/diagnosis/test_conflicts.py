"""Conflicts of robots, whose clauses are Horn and whose conflicts are made minimal by unit propagation."""

from __future__ import annotations

import random
from typing import Any

import pytest
from pysat.solvers import Solver
from tests.diagnosis.netlists import circuit

from robomend.diagnosis import shrinking
from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.observed import ObservationReader
from robomend.diagnosis.result import Conflict, Options
from robomend.errors import ContradictoryModel
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


def test_conflicts_of_circuits_are_minimal_or_said_not_to_be(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = circuit("c880").observe(3, 5)
    cnf = circuit("c880").cnf
    for calls, minimal in ((1_000, True), (0, False)):
        monkeypatch.setattr(shrinking, "CALLS", calls)
        result = make_engine("sat", cnf).diagnose(seen, Options("cardinality", limit=1))
        assert result.conflicts
        for conflict in result.conflicts:
            assert conflict.minimal == minimal
            assert not consistent(cnf, conflict.components, conflict.observations)
            needed = [
                consistent(cnf, tuple(c for c in conflict.components if c != name), tuple(seen))
                for name in conflict.components
            ]
            assert all(needed) or not minimal


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
