"""What nothing may switch off or stop: the protected components, and what they cannot do without."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.planning.robots import texts

from robomend.model.components import ComponentModel, Hardware, Node
from robomend.planning.planning import PlanOptions, plan_for
from robomend.planning.protection import protected_channels, protection
from robomend_client.literals import fails

ARM = ComponentModel(
    "arm",
    {
        "rail": Hardware("rail", 1),
        "hub": Hardware("hub", fed_by=("rail",)),
        "arm": Hardware("arm", 3, fed_by=("hub",)),
        "lamp": Hardware("lamp", 4, fed_by=("hub",)),
    },
    {
        "planner": Node("planner", publishes={"path": ()}),
        "moveit": Node("moveit", publishes={"plan": ("path",)}, tied_to=("planner",)),
        "traj_ctl": Node("traj_ctl", publishes={"cmd": ("plan",)}, tied_to=("moveit",)),
        "view": Node("view", publishes={"img": ("cmd",)}, tied_to=("traj_ctl",)),
    },
    {},
    protected_channels=(0,),
)


def test_feeders_are_protected_with_what_they_feed_through_hubs_without_channel() -> None:
    assert protection(ARM, ["arm"]) == {
        "arm": "arm is protected",
        "hub": "arm, which it feeds, is protected",
        "rail": "arm, which it feeds, is protected",
    }


def test_a_node_that_a_protected_one_must_follow_is_protected_too_and_its_followers_are_not() -> None:
    assert protection(ARM, ["traj_ctl"]) == {
        "traj_ctl": "traj_ctl is protected",
        "moveit": "traj_ctl, tied to it, is protected",
        "planner": "traj_ctl, tied to it, is protected",
    }


def test_a_device_is_protected_with_its_driver_and_so_is_what_feeds_it() -> None:
    driven = replace(ARM, nodes={**ARM.nodes, "arm_d": Node("arm_d", drives=("arm",))})
    device = "arm_d, its driver, which would have to restart after it, is protected"
    assert protection(driven, ["arm_d"]) == {
        "arm_d": "arm_d is protected",
        "arm": device,
        "hub": "arm, which it feeds, is protected",
        "rail": "arm, which it feeds, is protected",
    }
    assert protected_channels(driven, protection(driven, ["arm_d"]))[3] == device
    assert protection(driven, ["arm"]).keys() == {"arm", "hub", "rail"}  # its driver may be restarted


def test_the_channels_are_those_of_protected_devices_and_those_that_are_named() -> None:
    assert protected_channels(ARM, protection(ARM, ["arm"]), [7]) == {
        0: "nothing switches it off",
        1: "arm, which it feeds, is protected",
        3: "arm is protected",
        7: "nothing switches it off",
    }


RESPAWN = """
(define (domain robot-repair)
  (:action respawn
    :parameters (?n - node)
    :precondition (and (running ?n) (bad ?n))
    :effect (and (good ?n) (not (bad ?n))
      (forall (?m - node) (when (tied ?m ?n) (and (bad ?m) (not (good ?m)))))
      (increase (total-cost) 1))))
"""


AIDED = """
(define (domain robot-repair)
  (:predicates (helps ?h - hardware ?n - node))
  (:action respawn
    :parameters (?n - node ?h - hardware)
    :precondition (and (helps ?h ?n) (running ?n) (bad ?n))
    :effect (and (good ?n) (not (bad ?n))
      (forall (?m - node) (when (tied ?m ?n) (and (bad ?m) (not (good ?m)))))
      (increase (total-cost) 1)))
  (:init (helps rail moveit)))
"""


@pytest.mark.parametrize(
    ("domain", "step"),
    [(RESPAWN, "respawn(moveit)"), (AIDED, "respawn(moveit, rail)")],
    ids=["alone", "aided"],
)
def test_a_user_s_action_breaks_no_protected_node_that_is_tied_to_what_it_restarts(
    planner: str, domain: str, step: str
) -> None:
    options = PlanOptions(planner=planner, domain=domain)
    assert texts(plan_for(ARM, [], ["moveit"], options))[0] == step
    safe = plan_for(ARM, [], ["moveit"], replace(options, protected=("traj_ctl",)))
    assert texts(safe) == []
    assert "traj_ctl, tied to it, is protected" in safe.unreachable[0]


RESET = """
(define (domain robot-repair)
  (:action reset
    :parameters (?h - hardware)
    :precondition (and (on ?h) (bad ?h))
    :effect (and (good ?h) (not (bad ?h))
      (forall (?n - node) (when (drives ?n ?h) (and (bad ?n) (not (good ?n)))))
      (increase (total-cost) 1))))
"""


def test_nothing_resets_the_device_of_a_protected_driver_and_what_is_off_is_switched_on(planner: str) -> None:
    driven = replace(ARM, nodes={"arm_d": Node("arm_d", drives=("arm",), publishes={"joints": ()})})
    options = PlanOptions(planner=planner, domain=RESET)
    assert texts(plan_for(driven, [], ["arm"], options))[0] == "reset(arm)"
    safe = replace(options, protected=("arm_d",))
    kept = plan_for(driven, [], ["arm"], safe)
    assert texts(kept) == []
    assert "arm_d, its driver, which would have to restart after it, is protected" in kept.unreachable[0]
    off = plan_for(driven, [fails("on", "arm")], ["arm"], safe)
    assert texts(off) == ["power_up(arm)"]
