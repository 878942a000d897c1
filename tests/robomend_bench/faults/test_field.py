"""The world of the field: its classes, its robots, and that the simulation does what the truth says of it."""

from __future__ import annotations

import random
from collections.abc import Sequence

import pytest
from tests.robomend_bench.faults.small import odd

from robomend_bench.faults.classes import FaultClass, draw
from robomend_bench.faults.condition import HEALTHY, Act, abnormal
from robomend_bench.faults.field import BY_NAME, FIELD, WORLDS
from robomend_bench.faults.kinds import PASSING, Fault, begun, settled
from robomend_bench.faults.record import Acted, Arrived, Credited, Record, RepairSeen, Trial
from robomend_bench.faults.robot import Robot, find_robot, robot_names
from robomend_bench.faults.scoring import Score, score
from robomend_bench.faults.standins import play_with
from robomend_bench.faults.stretches import STRETCHES
from robomend_bench.faults.times import Part, where_time_goes
from robomend_bench.faults.trial import Terms, robot_of, scenario_of
from robomend_client.literals import holds

DISTURBED = frozenset({"starved-agent", "starved-owner", "starved-planner", "link", "gateway"})
"""What makes these is not done to stand-ins; what a bridge makes of a gateway's words is its affair."""


def able(described: FaultClass) -> list[str]:
    return [name for name in robot_names("field") if described.faults(find_robot(name).anatomy)]


def played(standin: str, trials: Sequence[Trial]) -> list[Score]:
    terms = Terms("fast", most_s=60.0 if trials[0].cls == "short-lived" else 200.0)
    return [score(play_with(standin, trial, terms), robot_of(trial)) for trial in trials]


def test_shares_are_percent_and_no_name_is_of_two_worlds() -> None:
    assert sum(each.share for each in FIELD) == 100
    assert len(BY_NAME) == sum(len(classes) for classes in WORLDS.values())
    assert {each.name for each in STRETCHES}.isdisjoint(BY_NAME)


@pytest.mark.parametrize("described", FIELD, ids=lambda each: each.name)
def test_each_class_shows_something_on_each_robot_that_has_it(described: FaultClass) -> None:
    assert able(described)
    for name in able(described):
        anatomy = find_robot(name).anatomy
        assert draw(described, anatomy, random.Random(7)) == draw(described, anatomy, random.Random(7))
        for fault in described.faults(anatomy):
            assert abnormal(anatomy, begun(anatomy, fault)), fault


@pytest.mark.parametrize("described", [e for e in FIELD if e.name not in DISTURBED], ids=lambda e: e.name)
def test_who_knows_the_truth_is_right_and_does_nothing_in_vain(described: FaultClass) -> None:
    trials = [Trial(name, described.name, 1, 1) for name in able(described)[:2]]
    for found in played("perfect", trials):
        assert (found.wrong, found.false_repaired, found.called_healthy) == ([], [], []), found
        if described.name != "short-lived":  # he takes it for well for as long as it is
            assert found.right, found
        if not any(fault.kind in PASSING for fault in scenario_of(trials[0]).faults):
            assert (found.extra or 0) <= 0, found  # he knows which drivers reconnect


# --- what the robots do ----------------------------------------------------------------------------------


def held(trial: Trial, standin: str = "idle") -> set[str]:
    """Return what the observers say last."""
    record = play_with(standin, trial, Terms("fast", most_s=200.0))
    said = {literal.atom: literal for _, literals in record.said for literal in literals}
    return {str(literal) for literal in said.values() if literal.atom.predicate not in ("const", "dec")}


@pytest.mark.parametrize(
    ("cls", "number"),
    [(each, number) for each in ("stands-still", "complains", "too-fast") for number in (1, 2)],
)
def test_real_observers_see_what_the_truth_says(cls: str, number: int) -> None:
    trial = Trial("cart", cls, 1, number)
    anatomy = robot_of(trial).anatomy
    wrong = odd(anatomy, begun(anatomy, *scenario_of(trial).faults))
    assert wrong
    assert {literal for literal in held(trial) if literal.startswith("not ")} == wrong


@pytest.mark.parametrize("cls", ["comes-back", "link"])
def test_of_what_passes_only_what_nobody_could_know_is_excused(cls: str) -> None:
    """A relay that is seen to be open may be closed; that a radio is gone for a moment calls for no act."""
    trial = Trial("pair", cls, 1, 1)
    robot, [fault] = robot_of(trial), scenario_of(trial).faults
    gone = begun(robot.anatomy, fault)
    record = Record(trial, "fast", end_s=20.0)
    record.faults, record.states = [(0.0, fault)], [(0.0, gone), (4.0, HEALTHY)]
    name, part = ("power_up", fault.component) if cls == "comes-back" else ("stop_node", "bridge")
    record.acts = [Acted(1.0, Act(name, (part,)), "agent", 0)]
    found = score(record, robot)
    assert (found.best_acts == 0) is (cls == "link")
    where = where_time_goes(record, robot.anatomy, 0.0, 6.0)
    lasts_s = 4.0 if cls == "comes-back" else 0.0  # for which something could have been done
    assert where[Part.PASSES] == pytest.approx(6.0 - lasts_s)


# --- what is false ---------------------------------------------------------------------------------------


def arrived(
    at_s: float, *texts: str, lifetime_s: float = 5.0, took_s: float = 0.01, late_s: float = 0.0
) -> Arrived:
    literals = tuple(-holds("ok", t.removeprefix("not ")) if "not " in t else holds("ok", t) for t in texts)
    return Arrived(at_s, "onboard", literals, (), lifetime_s, at_s - took_s, at_s - late_s)


def test_who_is_held_up_observes_nothing_meanwhile_and_is_believed_for_the_lifetime_of_its_words() -> None:
    cart = find_robot("cart")
    robot = Robot("cart", cart.model, cart.anatomy, world="field")
    record = Record(Trial("cart", "starved-agent", 1, 1), "fast", end_s=20.0)
    record.states = [(0.0, settled(cart.anatomy, Fault("planner", "hung")))]
    record.called_healthy = [(4.9, 5.0)]
    assert score(record, robot).called_healthy
    record.held_up = [("elsewhere", 0.0, 4.8)]
    assert score(record, robot).called_healthy
    (host,) = cart.anatomy.hosts
    record.held_up = [(host, second + 0.1, second + 1.0) for second in range(5)]
    assert score(record, robot).called_healthy == []  # it ran for half a second
    record.arrived = [arrived(0.0, "path", lifetime_s=2.0)]
    assert score(record, robot).called_healthy == ["5.00 s: ok(path) had not been said again in its lifetime"]


@pytest.mark.parametrize(
    ("batches", "false"),
    [
        ([arrived(1.0, "scan"), arrived(9.0, "scan")], ""),
        ([arrived(8.0, "scan"), arrived(9.0, "not scan")], "not ok(scan) was said last"),
        ([arrived(8.0, "not scan"), arrived(9.95, "scan")], ""),
        ([arrived(8.0, "not scan"), arrived(10.5, "scan")], "not ok(scan) was said last"),
        (
            [arrived(8.0, "not scan"), arrived(10.5, "scan", took_s=0.6)],
            "",
        ),  # it may be known, and not answered
        ([arrived(8.0, "scan"), arrived(9.0, "not scan", late_s=1.5)], ""),  # it was overtaken
        ([arrived(8.0, "scan", late_s=1.5), arrived(9.0, "not scan")], "not ok(scan) was said last"),
        ([arrived(1.0, "scan", lifetime_s=8.9)], "ok(scan) had not been said again in its lifetime"),
        ([arrived(1.0, "scan", lifetime_s=8.9), arrived(10.5, "scan", took_s=0.6)], ""),
    ],
)
def test_repaired_is_false_over_what_was_bad_or_had_lapsed(batches: list[Arrived], false: str) -> None:
    pair = find_robot("cart")
    robot = Robot("cart", pair.model, pair.anatomy, world="field")
    record = Record(Trial("cart", "slow-node", 1, 1), "fast", end_s=20.0)
    record.faults = [(0.0, Fault("planner", "hung"))]
    record.arrived = batches
    record.repairs = [RepairSeen(10.0, "r-1", "repaired", ("planner",), 1, "", ())]
    assert any(false in each for each in score(record, robot).false_repaired) == bool(false)


@pytest.mark.parametrize(
    ("broken", "acted_on", "did_nothing"),
    [
        (Fault("imu", "hung"), ("hub",), False),  # which feeds it
        (Fault("imu", "hung"), ("lidar", "lidar_driver"), True),
        (Fault("lidar_driver", "hung"), ("lidar_driver",), False),
        (Fault("base", "hung"), ("hub", "lidar_driver"), True),
    ],
)
def test_who_cycles_a_supply_is_credited_with_what_hangs_on_it(
    broken: Fault, acted_on: tuple[str, ...], did_nothing: bool
) -> None:
    record = Record(Trial("cart", "every-observer", 1, 1), "fast", end_s=20.0)
    cart = robot_of(record.trial)
    record.faults = [(0.0, broken)]
    record.states = [(0.0, begun(cart.anatomy, broken)), (3.0, HEALTHY)]
    record.credited = [Credited(2.0, 4.0, acted_on)]
    assert bool(score(record, cart).credited) is did_nothing
