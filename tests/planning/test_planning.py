"""From a diagnosis to a validated plan: the paper's scenarios, and what stands in the way of others."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.planning.robots import ALL_OFF, POWER_UP, TEDUSAR, texts

from robomend.model.components import ComponentModel, Hardware, Node
from robomend.planning.domain.loading import shipped
from robomend.planning.plan import Outcome
from robomend.planning.planning import PlanOptions, plan_for, plans_for
from robomend_client.literals import fails, holds

# --- the paper's scenarios ------------------------------------------------------------------------


def test_each_diagnosis_is_planned_for_and_those_after_the_time_have_no_answer() -> None:
    seen = [fails("on", "jaguar")]
    for timeout_s in (None, 60.0):
        both = plans_for(TEDUSAR, seen, [["jaguar"], ["jaguar_node"]], PlanOptions(timeout_s=timeout_s))
        assert [plan.outcome for plan in both] == [Outcome.SOLVED] * 2
    late = plans_for(TEDUSAR, seen, [["jaguar"], ["jaguar_node"]], PlanOptions(timeout_s=0.0))
    assert late[1].outcome is Outcome.GAVE_UP


# --- what is assumed, left out, protected ---------------------------------------------------------


def test_what_nobody_observed_of_a_bad_component_is_assumed_and_said() -> None:
    plan = plan_for(TEDUSAR, [], ["hokuyo"])
    assert plan.assumed == (holds("on", "hokuyo"),)
    assert plan_for(TEDUSAR, [holds("on", "hokuyo")], ["hokuyo"]).assumed == ()


def test_unreachable_goals_are_named_and_the_rest_is_planned(planner: str) -> None:
    plan = plan_for(TEDUSAR, [], ["imu", "rviz"], PlanOptions(planner=planner))
    assert plan.outcome is Outcome.UNSOLVABLE
    assert plan.unreachable == ("imu: no known action makes it good (it has no power channel)",)
    assert texts(plan) == ["stop_node(rviz)", "start_node(rviz)"]


def test_the_reason_names_what_is_in_the_way() -> None:
    plan = plan_for(TEDUSAR, [fails("running", "imu_node")], ["imu", "imu_node"])
    assert plan.unreachable[1] == (
        "imu_node: start_node(imu_node) needs good(imu), and no known action brings that about"
    )


def test_nodes_that_are_meant_to_be_stopped_are_left_alone(planner: str) -> None:
    options = PlanOptions(planner=planner, expected_stopped=("hokuyo_node",))
    plan = plan_for(TEDUSAR, ALL_OFF, POWER_UP, options)
    assert plan.excluded == ("hokuyo_node",)
    assert not any("hokuyo_node" in text for text in texts(plan))
    assert "start_node(hector_mapping)" in texts(plan)


def test_quarantined_components_are_left_alone_and_what_needs_them_is_named() -> None:
    plan = plan_for(TEDUSAR, ALL_OFF, POWER_UP, PlanOptions(quarantined=("jaguar",)))
    assert "power_up(jaguar)" not in texts(plan)
    assert plan.unreachable == (
        "jaguar_node: start_node(jaguar_node) needs good(jaguar), and power_up(jaguar) is refused: "
        "jaguar is left alone",
    )


def test_what_a_supply_drags_along_is_restarted_in_quarantine_or_not() -> None:
    robot = ComponentModel(
        "fed",
        {"supply": Hardware("supply", 1), "lidar": Hardware("lidar", None, ("supply",))},
        {
            "driver": Node("driver", ("lidar",), {"scan": ()}),
            "filter": Node("filter", (), {"clean": ("scan",)}, tied_to=("driver",)),
        },
        {},
    )
    left_alone = PlanOptions(quarantined=("driver", "filter"))
    done = texts(plan_for(robot, (), ("supply",), left_alone))
    assert {"start_node(driver)", "start_node(filter)"} <= set(done)
    assert done == texts(plan_for(robot, (), ("supply",)))


def test_what_hangs_on_a_supply_comes_back_with_it_and_its_drivers_restart(planner: str) -> None:
    """Without a channel of its own nothing else could bring it back; also through a hub without channel."""
    hardware = {
        "psu": Hardware("psu", 0),
        "hub": Hardware("hub", None, fed_by=("psu",)),
        "camera": Hardware("camera", None, fed_by=("hub",)),
        "lidar": Hardware("lidar", 1, fed_by=("hub",)),
    }
    nodes = {
        "camera_node": Node("camera_node", drives=("camera",), publishes={"image": ()}),
        "lidar_node": Node("lidar_node", drives=("lidar",), publishes={"scan": ()}),
    }
    robot = ComponentModel("r", hardware, nodes, {})
    options = PlanOptions(planner=planner)
    restarts = {f"{action}({node})" for action in ("stop_node", "start_node") for node in nodes}
    cycled = plan_for(robot, [], ["psu"], options)
    assert cycled.outcome is Outcome.SOLVED
    assert texts(cycled)[0] == "shutdown(psu)"
    assert set(texts(cycled)) == {"shutdown(psu)", "power_up(psu)", *restarts}  # lidar's relay stays closed
    came_back = plan_for(robot, [fails("on", "psu")], ["psu"], options)
    assert set(texts(came_back)) == {"power_up(psu)", *restarts}
    assert texts(came_back)[0] == "power_up(psu)"
    safe = plan_for(robot, [], ["psu"], replace(options, protected=("camera",)))
    assert texts(safe) == []


def test_a_spare_that_is_meant_to_be_off_is_switched_on_by_nothing_but_the_users_action(planner: str) -> None:
    spare = """
    (define (domain robot-repair)
      (:predicates (spare_for ?s ?h - hardware))
      (:action use_spare
        :parameters (?h ?s - hardware)
        :precondition (and (spare_for ?s ?h) (bad ?h) (off ?s))
        :effect (and (on ?s) (not (off ?s)) (good ?h) (not (bad ?h)) (increase (total-cost) 5)))
      (:init (spare_for gps_b gps_a)))
    """
    robot = ComponentModel("r", {"gps_a": Hardware("gps_a", 0), "gps_b": Hardware("gps_b", 1)}, {}, {})
    off = [fails("on", "gps_b")]
    options = PlanOptions(planner=planner, domain=spare, expected_stopped=("gps_b",))
    assert texts(plan_for(robot, off, ["gps_a"], options)) == ["use_spare(gps_a, gps_b)"]
    assert texts(plan_for(robot, off, ["gps_b"], options)) == []
    quarantined = replace(options, expected_stopped=(), quarantined=("gps_b",))
    assert texts(plan_for(robot, off, ["gps_a"], quarantined)) == ["shutdown(gps_a)", "power_up(gps_a)"]


def test_names_may_hold_what_pddl_cannot() -> None:
    robot = ComponentModel(
        "r",
        {"Front/Lidar 1": Hardware("Front/Lidar 1", 1)},
        {"front": Node("front"), "Front": Node("Front")},
        {},
    )
    plan = plan_for(robot, [], ["Front/Lidar 1", "Front"], PlanOptions(pddl=True))
    assert "power_up(Front/Lidar 1)" in texts(plan)
    assert "start_node(Front)" in texts(plan)
    assert plan.pddl is not None
    assert ";; o0 is Front/Lidar 1" in plan.pddl[1]


# --- structure ------------------------------------------------------------------------------------


def test_what_is_tied_to_a_node_that_ended_restarts_after_that_is_back(planner: str) -> None:
    nodes = {
        "core": Node("core"),
        "bridge": Node("bridge", tied_to=("core",)),
        "view": Node("view", tied_to=("bridge",)),
        "other": Node("other"),
    }
    robot = ComponentModel("r", {}, nodes, {})
    seen = [fails("running", "core"), *(holds("running", name) for name in ("bridge", "view", "other"))]
    plan = plan_for(robot, seen, ["core"], PlanOptions(planner=planner))
    assert sorted(texts(plan)) == [
        "start_node(bridge)",
        "start_node(core)",
        "start_node(view)",
        "stop_node(bridge)",
        "stop_node(view)",
    ]
    after = {str(step): {str(plan.steps[i]) for i in step.after} for step in plan.steps}
    assert "start_node(core)" in after["stop_node(bridge)"]
    assert "start_node(bridge)" in after["stop_node(view)"]

    kept = plan_for(robot, seen, ["core"], PlanOptions(planner=planner, protected=("bridge",)))
    assert texts(kept) == ["start_node(core)"]  # what bridge was tied to is gone in any case
    left_alone = PlanOptions(planner=planner, quarantined=("core",))
    assert texts(plan_for(robot, seen, ["core"], left_alone)) == []
    dragged = PlanOptions(planner=planner, quarantined=("bridge",))
    assert texts(plan_for(robot, seen, ["core"], dragged)) == texts(plan)
    meant_so = PlanOptions(planner=planner, expected_stopped=("core",))
    assert texts(plan_for(robot, seen, [], meant_so)) == []


def test_nothing_is_stopped_before_all_is_done_that_its_start_waits_for(planner: str) -> None:
    """The watch restarts after the skill that it is tied to; should that not start, the watch runs on."""
    nodes = {
        "driver": Node("driver", drives=("arm",), publishes={"joints": ()}),
        "skill": Node("skill", publishes={"grip": ("joints",)}),
        "watch": Node("watch", publishes={"seen": ("grip",)}, tied_to=("skill",)),
    }
    robot = ComponentModel("r", {"arm": Hardware("arm", 1)}, nodes, {})
    seen = [fails("running", "skill"), *(holds("running", name) for name in ("driver", "watch"))]
    plan = plan_for(robot, seen, ["skill"], PlanOptions(planner=planner))
    assert texts(plan) == ["start_node(skill)", "stop_node(watch)", "start_node(watch)"]
    assert [step.after for step in plan.steps] == [(), (0,), (1,)]
    hung = plan_for(robot, [], ["arm", "skill", "watch"], PlanOptions(planner=planner))
    before = {str(step): {str(hung.steps[i]) for i in step.after} for step in hung.steps}
    assert before["stop_node(driver)"] == {"power_up(arm)"}
    assert before["stop_node(skill)"] == {"start_node(driver)"}
    assert before["stop_node(watch)"] == {"start_node(skill)"}


@pytest.mark.parametrize("keep", [False, True])
def test_a_driver_that_reconnects_is_not_restarted_with_its_device(planner: str, keep: bool) -> None:
    nodes = {
        "lidar_d": Node("lidar_d", drives=("lidar",), publishes={"scan": ()}, reconnects=keep),
        "cam_d": Node("cam_d", drives=("cam",), publishes={"img": ()}, reconnects=True),
    }
    hardware = {
        "rail": Hardware("rail", 1),
        "lidar": Hardware("lidar", 2, fed_by=("rail",)),
        "cam": Hardware("cam", fed_by=("rail",)),
    }
    robot = ComponentModel("r", hardware, nodes, {})
    restart = [] if keep else ["stop_node(lidar_d)", "start_node(lidar_d)"]
    options = PlanOptions(planner=planner)
    assert texts(plan_for(robot, [fails("on", "lidar")], ["lidar"], options)) == ["power_up(lidar)", *restart]
    cycle = ["shutdown(rail)", "power_up(rail)", *restart]
    assert texts(plan_for(robot, [], ["rail"], options)) == cycle
    # Where it is itself blamed, it is restarted as any.
    assert "stop_node(cam_d)" in texts(plan_for(robot, [], ["cam_d"], options))


def test_what_is_not_known_to_have_ended_is_stopped_first(planner: str) -> None:
    nodes = {"a": Node("a", publishes={"t": ()}), "b": Node("b", publishes={"u": ("t",)})}
    robot = ComponentModel("r", {}, nodes, {})
    seen = [fails("running", "a"), holds("running", "b")]
    ended = plan_for(robot, seen, ["a"], PlanOptions(planner=planner))
    assert texts(ended) == ["start_node(a)"]
    lingers = plan_for(robot, seen, ["a"], PlanOptions(planner=planner, lingering=("a", "b")))
    assert texts(lingers) == ["stop_node(a)", "start_node(a)"]
    assert [step.after for step in lingers.steps] == [(), (0,)]
    paper = PlanOptions(planner=planner, lingering=("a",), domain=shipped("paper-repair.pddl"))
    assert texts(plan_for(robot, seen, ["a"], paper)) == ["start_node(a)"]


def test_goals_that_exclude_each_other_are_said_honestly(planner: str) -> None:
    """The device comes back only at the price of a driver that cannot be restarted."""
    nodes = {"driver": Node("driver", ("arm",), restartable=False)}
    robot = ComponentModel("r", {"arm": Hardware("arm", 1)}, nodes, {})
    plan = plan_for(robot, [], ["arm"], PlanOptions(planner=planner))
    assert plan.outcome is Outcome.UNSOLVABLE
    assert plan.unreachable == ("driver: cannot be made good together with arm",)
    assert texts(plan) == ["shutdown(arm)", "power_up(arm)"]
