"""Where the time from detection to repaired goes: each moment has one part, and they add up."""

from __future__ import annotations

import pytest

from robomend_bench.faults.record import Trial
from robomend_bench.faults.robot import find_robot
from robomend_bench.faults.scoring import score
from robomend_bench.faults.standins import play_with
from robomend_bench.faults.trial import Terms


@pytest.mark.parametrize("trial", ["base/hung-node/1.1", "underwater/feed/1.2", "loops/loop/1.3"])
def test_the_parts_of_a_trial_are_in_its_score_and_add_up(trial: str) -> None:
    robot, cls, _ = trial.split("/")
    found = score(play_with("perfect", Trial(robot, cls, 1, 1), Terms("fast")), find_robot(robot))
    assert found.repaired_s is not None
    assert sum(found.parts.values()) == pytest.approx(found.repaired_s)
    assert found.parts["acts"] > 0.1
    assert found.parts["missing effect"] == 0  # it knows what helps
