"""What can be told of a robot: explanations, suspects, told apart."""

from __future__ import annotations

import pytest
from tests.robomend_bench.faults.small import ROBOT, with_faults

from robomend_bench.faults.classes import universe_of
from robomend_bench.faults.condition import abnormal

UNIVERSE = universe_of(ROBOT)


def told_apart(*pairs: tuple[str, str]) -> bool:
    state = with_faults(*pairs)
    return UNIVERSE.told_apart({component for component, _ in pairs}, abnormal(ROBOT, state))


@pytest.mark.parametrize(
    ("fault", "apart"),
    [
        (("mapper", "hung"), True),
        (("driver", "dead"), True),
        (("lidar", "off"), True),
        (("driver", "hung"), False),  # or the lidar
        (("lidar", "hung"), False),  # or the driver
        (("lidar", "broken"), False),
        (("driver", "half-rate"), True),  # a device that hangs silences the rest, too
        (("planner", "half-rate"), True),
        (("controller", "hung"), False),  # or the estimator
        (("controller", "dead"), True),
    ],
)
def test_what_can_be_told_apart(fault: tuple[str, str], apart: bool) -> None:
    assert told_apart(fault) is apart
