"""Plans with the user's own actions: a last resort, a bus reset, a spare."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from tests.planning.robots import TEDUSAR, texts

from robomend.model.components import ComponentModel, Hardware, Node
from robomend.planning.planning import PlanOptions, plan_for
from robomend_client.literals import fails, holds

OPERATOR = """
(define (domain robot-repair)
  (:action call_operator
    :parameters (?c - component)
    :precondition (bad ?c)
    :effect (and (good ?c) (not (bad ?c)) (increase (total-cost) 500))))
"""


def test_a_last_resort_is_not_taken_first_because_it_is_short(planner: str) -> None:
    options = PlanOptions(planner=planner, domain=OPERATOR)
    assert plan_for(TEDUSAR, [], ["hokuyo"], options).cost == 15 + 10 + 1 + 3
    assert texts(plan_for(TEDUSAR, [], ["imu"], options)) == ["call_operator(imu)"]


def test_the_example_stops_a_driver_that_is_well_before_its_device_is_reset(planner: str) -> None:
    path = Path(__file__).parents[2] / "examples" / "actions" / "driver_first.pddl"
    recipe = path.read_text(encoding="utf-8")
    options = PlanOptions(planner=planner, domain=recipe)
    plan = plan_for(TEDUSAR, [holds("running", "imu_node")], ["imu"], options)
    assert texts(plan) == ["let_go(imu_node)", "reset_usb(usb1)", "start_node(imu_node)"]
    stopped = plan_for(TEDUSAR, [fails("running", "imu_node")], ["imu", "imu_node"], options)
    assert texts(stopped) == ["reset_usb(usb1)", "start_node(imu_node)"]
    kept = replace(options, protected=("imu_node",))
    assert texts(plan_for(TEDUSAR, [holds("running", "imu_node")], ["imu"], kept)) == []


SPARE = """
(define (domain robot-repair)
  (:predicates (spare_for ?s - hardware ?h - hardware))
  (:action switch_to_spare
    :parameters (?h - hardware ?s - hardware)
    :precondition (and (spare_for ?s ?h) (bad ?h) (not (on ?s)))
    :effect (and (on ?s) (not (off ?s)) (good ?s) (not (bad ?s)) (off ?h) (not (on ?h))
      (good ?h) (not (bad ?h))
      (forall (?n - node) (when (drives ?n ?h) (and (bad ?n) (not (good ?n)))))
      (increase (total-cost) 8)))
  (:init (spare_for lidar2 lidar)))
"""


def test_a_spare_takes_over_where_the_device_cannot_come_back(planner: str) -> None:
    """The spare is meant to be off, so it is no goal; the broken device has no channel to cycle."""
    robot = ComponentModel(
        "r",
        {"lidar": Hardware("lidar"), "lidar2": Hardware("lidar2", 2)},
        {"lidar_node": Node("lidar_node", ("lidar",))},
        {},
    )
    options = PlanOptions(planner=planner, domain=SPARE)
    plan = plan_for(robot, [fails("on", "lidar2")], ["lidar", "lidar2"], options)
    assert texts(plan) == [
        "switch_to_spare(lidar, lidar2)",
        "stop_node(lidar_node)",
        "start_node(lidar_node)",
    ]
    seen = [holds("on", "lidar2")]
    assert texts(plan_for(robot, seen, ["lidar"], options)) == []


def test_an_action_is_refused_for_what_it_switches_off_whatever_else_it_changes(planner: str) -> None:
    text = """(define (domain robot-repair)
      (:predicates (wired ?h ?g - hardware))
      (:init (wired base arm))
      (:action unwire :parameters (?h ?g - hardware) :precondition (and (wired ?h ?g) (bad ?h))
        :effect (and (not (wired ?h ?g)) (not (on ?g)) (off ?g) (not (bad ?h)) (good ?h)
          (increase (total-cost) 1))))"""
    robot = ComponentModel("r", {"base": Hardware("base", None), "arm": Hardware("arm", 2)}, {}, {})
    options = PlanOptions(planner=planner, domain=text)
    assert "unwire(base, arm)" in texts(plan_for(robot, [], ["base"], options))
    safe = plan_for(robot, [], ["base"], replace(options, protected=("arm",)))
    assert texts(safe) == []


LENS = """
(define (domain robot-repair)
  (:predicates (left ?h - hardware) (right ?h - hardware))
  (:action turn_left
    :parameters (?h - hardware)
    :precondition (bad ?h)
    :effect (and (left ?h) (not (right ?h)) (increase (total-cost) 1)))
  (:action turn_right
    :parameters (?h - hardware)
    :precondition (bad ?h)
    :effect (and (right ?h) (not (left ?h)) (increase (total-cost) 1)))
  (:action hold
    :parameters (?h - hardware)
    :precondition (and (left ?h) (right ?h))
    :effect (and (good ?h) (not (bad ?h)) (increase (total-cost) 1)))
  (:action wipe
    :parameters (?h - hardware ?arm - hardware)
    :precondition (and (bad ?h) (fed_by ?h ?arm) (left ?arm))
    :effect (and (good ?h) (not (bad ?h)) (increase (total-cost) 1))))
"""


def test_what_nothing_brings_back_is_not_blamed_on_what_is_brought_back_beside_it(planner: str) -> None:
    """What the arm needs excludes each other, in two steps; the camera's repair shares one of them."""
    robot = ComponentModel("r", {"arm": Hardware("arm"), "cam": Hardware("cam", fed_by=("arm",))}, {}, {})
    plan = plan_for(robot, [], ["arm", "cam"], PlanOptions(planner=planner, domain=LENS))
    assert plan.unreachable == ("arm: no sequence of known actions makes it good",)
    assert texts(plan) == ["turn_left(arm)", "wipe(cam, arm)"]
