"""Generated robots."""

from __future__ import annotations

import random

import pytest

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import Options
from robomend_bench.generator import make_robot, observe


@pytest.mark.parametrize("components", [3, 20, 101])
def test_a_robot_has_the_size_that_was_asked_for(components: int) -> None:
    assert len(make_robot(components, 1).cnf.components) == components


def test_the_same_seed_gives_the_same_robot_and_another_seed_another() -> None:
    assert make_robot(20, 1).cnf == make_robot(20, 1).cnf
    assert make_robot(20, 1).cnf != make_robot(20, 2).cnf


def test_a_healthy_robot_looks_healthy_and_a_broken_one_mostly_does_not() -> None:
    robot = make_robot(40, 1)
    engine = make_engine("sat", robot.cnf)
    assert engine.consistent(observe(robot, 0, random.Random(1)))
    broken = [observe(robot, 2, random.Random(seed)) for seed in range(20)]
    assert sum(not engine.consistent(seen) for seen in broken) >= 15
    engine.close()


def test_what_was_broken_explains_what_is_seen() -> None:
    robot = make_robot(12, 3)
    engine = make_engine("sat", robot.cnf)
    for seed in range(20):
        result = engine.diagnose(observe(robot, 2, random.Random(seed)), Options(limit=None))
        assert result.complete
        assert min(len(diagnosis.bad) for diagnosis in result.diagnoses) <= 2
    engine.close()
