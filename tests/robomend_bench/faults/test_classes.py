"""The robots and the classes of faults: shares, what takes part, and that the models know the faults."""

from __future__ import annotations

import random

import pytest

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.result import Options
from robomend.model.loading import load_text
from robomend_bench.faults.classes import CLASSES, FaultClass, draw
from robomend_bench.faults.condition import abnormal, observed
from robomend_bench.faults.kinds import begun
from robomend_bench.faults.live import knows
from robomend_bench.faults.policy import COSTS
from robomend_bench.faults.robot import Robot, find_robot, robot_names


def robots() -> dict[str, Robot]:
    """Return all robots by name, which are read once, and not while tests are collected."""
    return {name: find_robot(name) for name in robot_names()}


def test_shares_are_percent_and_faulty_observers_come_on_top() -> None:
    assert sum(each.share for each in CLASSES if not each.apart) == 100
    assert sum(each.share for each in CLASSES if each.apart) == 10


@pytest.mark.parametrize("described", CLASSES, ids=lambda each: each.name)
def test_each_class_is_played_on_some_robots(described: FaultClass) -> None:
    able = [name for name, robot in robots().items() if described.faults(robot.anatomy)]
    assert len(able) >= (1 if described.name == "spare" else 2)
    for name in able:
        anatomy = find_robot(name).anatomy
        scenario = draw(described, anatomy, random.Random(7))
        assert scenario == draw(described, anatomy, random.Random(7))
        assert scenario.faults or scenario.blind is not None
        for fault in scenario.faults:
            assert abnormal(anatomy, begun(anatomy, fault)), fault
            if not described.apart:
                assert fault in find_robot(name).universe.weights, fault


@pytest.mark.parametrize("name", robot_names("field"))
def test_the_model_is_accepted_and_no_fault_contradicts_it(name: str) -> None:
    robot = find_robot(name)
    system = load_text(robot.model, name=name)
    assert set(system.cnf.components) == {*robot.anatomy.devices, *robot.anatomy.nodes}
    engine = make_engine("sat", system.cnf)
    assert engine.consistent(robot.anatomy.healthy)
    for fault in robot.universe.shows:
        state = begun(robot.anatomy, fault)
        others = frozenset(system.cnf.components) - {fault.component}
        if len(robot.anatomy.fed.get(fault.component, ())) > 1:
            continue  # to the rules, `on` of what a supply feeds means power; a board tells the relay
        found = engine.diagnose(observed(robot.anatomy, state), Options(healthy=others))
        assert found.diagnoses, fault
    engine.close()


def test_a_healthy_robot_s_agents_know_what_its_repairs_need() -> None:
    for name, robot in robots().items():
        acts = set().union(*(knows(robot, host) for host in robot.anatomy.hosts))
        assert {act.name for act in acts} <= COSTS.keys(), name
        for fault in robot.universe.shows:
            state = begun(robot.anatomy, fault)
            done = robot.policy.outcome(state, [(state, 1.0)]).acts
            power = {"power_up", "shutdown"} if robot.anatomy.power == "board" else set()
            assert {act for act in done if act.name not in power} <= acts, (name, fault)
