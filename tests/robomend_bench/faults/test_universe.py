"""What can be told of a robot: explanations, suspects, told apart."""

from __future__ import annotations

import random

import pytest
from tests.robomend_bench.faults.small import ROBOT, with_faults

from robomend_bench.faults.anatomy import read_anatomy
from robomend_bench.faults.classes import universe_of
from robomend_bench.faults.condition import abnormal
from robomend_bench.faults.kinds import Fault, begun
from robomend_bench.faults.robot import find_robot, robot_names
from robomend_bench.faults.universe import first_silent, touched

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


def test_a_fault_behind_another_cannot_be_told() -> None:
    assert not told_apart(("mapper", "hung"), ("planner", "hung"))
    assert told_apart(("mapper", "dead"), ("planner", "dead"))


def test_who_fell_silent_first_tells_hung_nodes_of_a_loop_apart() -> None:
    state = with_faults(("controller", "hung"))
    odd = abnormal(ROBOT, state)
    assert first_silent(ROBOT, state) == {"command"}
    assert UNIVERSE.told_apart_by_onset({"controller"}, odd, state)
    hung = with_faults(("driver", "hung"))
    assert not UNIVERSE.told_apart_by_onset({"driver"}, abnormal(ROBOT, hung), hung)


def test_suspects_are_all_that_explains_with_as_few() -> None:
    assert UNIVERSE.suspects(abnormal(ROBOT, with_faults(("driver", "hung"))), 1) == {"driver", "lidar"}
    assert UNIVERSE.suspects(abnormal(ROBOT, with_faults(("mapper", "hung"))), 1) == {"mapper"}
    assert UNIVERSE.suspects(frozenset(), 1) == frozenset()


def test_explanations_are_as_large_as_it_takes() -> None:
    odd = abnormal(ROBOT, with_faults(("mapper", "dead"), ("planner", "dead")))
    assert {len(each.faults) for each in UNIVERSE.explanations(odd, 1)} == {2}
    one = abnormal(ROBOT, with_faults(("mapper", "dead")))
    assert {len(each.faults) for each in UNIVERSE.explanations(one, 1)} == {1}
    assert {len(each.faults) for each in UNIVERSE.explanations(one, 2)} == {1, 2}


def test_explanations_are_the_ways_to_cover_what_is_odd() -> None:
    odd = abnormal(ROBOT, with_faults(("mapper", "dead"), ("estimator", "hung")))
    found = {frozenset(map(str, each.faults)) for each in UNIVERSE.explanations(odd, 2)}
    assert found == {
        frozenset({"mapper dead", "estimator hung"}),
        frozenset({"mapper dead", "controller hung"}),
    }


@pytest.mark.parametrize("name", robot_names())
def test_what_two_faults_show_is_what_they_show_alone(name: str) -> None:
    robot, chance = find_robot(name), random.Random(name)
    faults = sorted(robot.universe.shows)
    for _ in range(50):
        first, second = chance.sample(faults, 2)
        if first.component != second.component:
            both = abnormal(robot.anatomy, begun(robot.anatomy, first, second))
            assert both == robot.universe.shows[first] | robot.universe.shows[second], (first, second)


def test_what_a_repair_may_touch() -> None:
    fed = read_anatomy(
        {
            "hardware": {"rail": {"channel": 1}, "cam": {"channel": 3, "fed_by": ["rail"]}},
            "nodes": {
                "cam_driver": {"drives": ["cam"], "publishes": {"image": []}},
                "viewer": {"publishes": {"view": ["image"]}, "tied_to": ["cam_driver"]},
                "other": {"publishes": {"words": []}},
            },
        },
        {},
    )
    assert touched(fed, "cam") == {"rail", "cam", "cam_driver", "viewer"}
    assert touched(fed, "viewer") == {"viewer"}


def test_faults_that_nobody_sees_are_in_no_universe() -> None:
    blind = read_anatomy(
        {"nodes": {"a": {"publishes": {"t": []}}}, "topics": {"t": {}}}, {"unobserved": ["t"]}
    )
    assert {fault.kind for fault in universe_of(blind).shows} >= {"dead"}
    assert Fault("a", "hung") not in universe_of(blind).shows
