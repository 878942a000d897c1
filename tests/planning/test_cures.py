"""How probably a plan cures what it is for, and which of two ways to cure it comes first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.planning.robots import TEDUSAR, texts

from robomend.diagnosis.result import Diagnosis, DiagnosisResult
from robomend.errors import ModelError
from robomend.model.components import ComponentModel
from robomend.model.loading import load_text
from robomend.planning.advice import Situation
from robomend.planning.choice import Candidate, choose
from robomend.planning.cures import (
    CURES,
    PRIOR_WEIGHT,
    ActOutcome,
    Avoided,
    Cure,
    SuccessRate,
    best_way,
    cured,
    curing,
    once,
    rates,
)
from robomend.planning.plan import Outcome, Plan
from robomend.planning.planning import PlanOptions, plan_for, plans_at_once, plans_for
from robomend_client.literals import Literal, fails

SPARE = """
(define (domain robot-repair)
  (:predicates (spare_for ?s ?h - hardware))
  (:action switch_to_spare
    :parameters (?h ?s - hardware)
    :precondition (and (spare_for ?s ?h) (bad ?h) (good ?s) (on ?s))
    :effect (and (good ?h) (not (bad ?h))
      (forall (?n - node) (when (drives ?n ?h) (and (bad ?n) (not (good ?n)))))
      (increase (total-cost) COST)))
  (:init (spare_for jaguar hokuyo)))
"""

CYCLE = ["shutdown(hokuyo)", "power_up(hokuyo)", "stop_node(hokuyo_node)", "start_node(hokuyo_node)"]
SWITCH = ["switch_to_spare(hokuyo, jaguar)", "stop_node(hokuyo_node)", "start_node(hokuyo_node)"]


def with_spare(cost: int | None, *observed: Literal, avoided: str = "") -> Plan:
    """Return the plan for a silent scanner that has a spare of this cost; None: it has none."""
    options = PlanOptions(
        domain=None if cost is None else SPARE.replace("COST", str(cost)),
        avoided=((avoided, "it was tried"),) if avoided else (),
    )
    [plan] = plans_for(TEDUSAR, observed, [("hokuyo",)], options)
    return plan


def instead(plan: Plan) -> Callable[[Avoided], Plan]:
    """Return a planner that knows this other way alone."""
    return lambda _: plan


def test_a_power_cycle_cures_a_device_every_other_time_and_the_driver_that_it_restarts_for_sure() -> None:
    plan = plan_for(TEDUSAR, [], ["hokuyo"])
    assert texts(plan) == CYCLE
    assert cured(plan, ["hokuyo"]) == cured(plan, ["hokuyo", "hokuyo_node"]) == CURES[Cure.POWER_CYCLE] == 0.5
    assert cured(plan, ["hokuyo_node"]) == 1.0


def test_a_device_that_works_in_part_does_not_hang() -> None:
    plan = plan_for(TEDUSAR, [], ["hokuyo", "jaguar"])
    partly = CURES[Cure.CYCLE_OF_WORKING]
    assert partly < CURES[Cure.POWER_CYCLE]
    assert cured(plan, ["hokuyo"], works=["hokuyo"]) == partly
    assert cured(plan, ["hokuyo", "jaguar"], works=["hokuyo"]) == partly * CURES[Cure.POWER_CYCLE]
    assert cured(plan, ["hokuyo_node"], works=["hokuyo_node"]) == 1.0


@pytest.mark.parametrize(("cost", "steps"), [(30, SWITCH), (53, SWITCH), (55, CYCLE), (None, CYCLE)], ids=str)
def test_a_spare_comes_before_a_power_cycle_unless_it_costs_more_than_twice_as_much(
    cost: int | None, steps: list[str]
) -> None:
    """29 for the cycle with the driver's restart, which is 4 of either."""
    assert texts(with_spare(cost)) == steps


def test_a_spare_that_was_no_help_leaves_the_power_cycle() -> None:
    assert texts(with_spare(30, avoided="switch_to_spare(hokuyo, jaguar)")) == CYCLE


def test_another_way_that_is_not_found_in_time_or_repairs_less_is_none() -> None:
    plan = plan_for(TEDUSAR, [], ["hokuyo"])
    cheap = replace(plan_for(TEDUSAR, [], ["hokuyo_node"]), cost=1.0)
    assert best_way(plan, ["hokuyo"], instead(cheap)) is cheap
    for worse in (
        replace(cheap, steps=()),
        replace(cheap, outcome=Outcome.GAVE_UP),
        replace(cheap, unreachable=("hokuyo: no",)),
    ):
        assert best_way(plan, ["hokuyo"], instead(worse)) is plan


def test_the_driver_s_restart_comes_before_either_and_the_reason_says_how_probably_each_helps() -> None:
    restart = Candidate(Diagnosis(("hokuyo_node",)), plan_for(TEDUSAR, [], ["hokuyo_node"]))
    for cost, words in (
        (30, "hokuyo: helps whichever of the suspected causes it is, at cost 34"),
        (70, "hokuyo: helps with probability 0.75 at cost 29"),  # 0.5 as the driver may be it
    ):
        choice = choose([restart, Candidate(Diagnosis(("hokuyo",)), with_spare(cost))])
        assert choice.plan is restart.plan
        assert choice.alternatives[1].reason == words


def test_of_a_power_cycle_the_cut_is_done_once_and_of_another_cure_the_act() -> None:
    assert once(plan_for(TEDUSAR, [], ["hokuyo"]), {"hokuyo"}) == {"shutdown(hokuyo)"}
    assert once(with_spare(30), {"hokuyo"}) == {"switch_to_spare(hokuyo, jaguar)"}
    assert once(with_spare(30), set()) == set()


def test_what_is_off_may_be_switched_on_and_a_process_restarted_again() -> None:
    assert once(plan_for(TEDUSAR, [fails("on", "hokuyo")], ["hokuyo"]), {"hokuyo"}) == set()
    assert once(plan_for(TEDUSAR, [], ["hokuyo_node"]), set()) == set()


# --- given in the model, learned from outcomes

CAMERA = """\
robomend: 1
hardware: {lidar: {channel: 1, helps: {power_cycle: 0.8}}}
nodes:
  camera:
    publishes: {image: []}
    modes: {soft: ["not ok(image)"], hard: ["not ok(image)", "not ok(log)"]}
    helps: {restart: {soft: 0.9, hard: 0.05}, redeploy: {soft: 0.9, hard: 0.95}}
  lidar_node: {drives: [lidar], publishes: {scan: []}}
remedies:
  redeploy: {mends: camera, cost: 8}
"""


def model(text: str = CAMERA) -> ComponentModel:
    parts = load_text(text).parts
    assert parts is not None
    return parts


def planned(known: dict[tuple[str, str], SuccessRate], text: str = CAMERA, bad: str = "camera") -> Plan:
    options = PlanOptions(rates=tuple(known.values()))
    at_once = plans_at_once(model(text), (), [[bad]], options)
    (plan,) = plans_for(model(text), (), [[bad]], options)
    assert at_once is not None
    assert texts(at_once[0]) == texts(plan)
    return plan


def test_the_fault_mode_decides_which_act_comes_first() -> None:
    soft, hard = ({"camera": mode} for mode in ("soft", "hard"))
    assert texts(planned(rates(model(), soft, ()))) == ["stop_node(camera)", "start_node(camera)"]
    assert texts(planned(rates(model(), hard, ()))) == ["redeploy(camera)"]
    assert texts(planned({})) == ["stop_node(camera)", "start_node(camera)"]  # the cheapest, as ever


def test_a_mode_that_says_what_another_one_says_is_not_known_nor_learned_of() -> None:
    alike = model(CAMERA.replace(', "not ok(log)"', ""))
    for told in ("soft", "hard"):
        found = rates(alike, {"camera": told}, [ActOutcome("camera", frozenset({"restart"}), False, "soft")])
        restart = found["restart", "camera"]
        assert restart.prior == pytest.approx(0.475)
        assert (restart.helped, restart.of) == (0, 1)


def test_outcomes_change_what_is_given_and_the_order_with_it() -> None:
    text = CAMERA.replace("{soft: 0.9, hard: 0.05}", "0.6").replace("{soft: 0.9, hard: 0.95}", "0.4")
    assert texts(planned(rates(model(text), {}, ()), text)) == ["stop_node(camera)", "start_node(camera)"]
    vain = [ActOutcome("camera", frozenset({"restart"}), False)] * 8
    cure = [ActOutcome("camera", frozenset({"redeploy"}), True)] * 8
    learned = rates(model(text), {}, [*vain, *cure])
    assert str(learned["restart", "camera"]) == "restart of camera 20% (60% given, 0 of 8 helped)"
    assert str(learned["redeploy", "camera"]) == "redeploy of camera 80% (40% given, 8 of 8 helped)"
    assert texts(planned(learned, text)) == ["redeploy(camera)"]


def test_what_came_of_it_in_the_fleet_is_what_one_begins_with() -> None:
    text = CAMERA.replace("{soft: 0.9, hard: 0.05}", "0.6").replace("{soft: 0.9, hard: 0.95}", "0.4")
    elsewhere = [ActOutcome("camera", frozenset({"restart"}), helped < 7, fleet=True) for helped in range(20)]
    own = [ActOutcome("camera", frozenset({"restart"}), helped < 2) for helped in range(3)]
    rate = rates(model(text), {}, [*elsewhere, *own])["restart", "camera"]
    assert str(rate) == "restart of camera 51% (60% given, 7 of 20 helped in the fleet, 2 of 3 helped)"
    assert rate.mean == pytest.approx((4 * (4 * 0.6 + 7) / 24 + 2) / 7)
    vain = [ActOutcome("camera", frozenset({"restart"}), False, fleet=True)] * 8
    assert texts(planned(rates(model(text), {}, vain), text)) == ["redeploy(camera)"]


def test_where_nothing_is_given_a_few_outcomes_or_good_ones_change_nothing() -> None:
    plain = CAMERA.replace(
        "    helps: {restart: {soft: 0.9, hard: 0.05}, redeploy: {soft: 0.9, hard: 0.95}}\n", ""
    )
    good, vain = (ActOutcome("camera", frozenset({"restart"}), helped) for helped in (True, False))
    assert ("restart", "camera") not in rates(model(plain), {}, [good] * 50)
    assert ("restart", "camera") not in rates(model(plain), {}, [vain] * 2)
    found = rates(model(plain), {}, [vain] * 2 + [good] * 2)["restart", "camera"]
    assert (found.given, found.mean) == (False, 0.75)
    assert ("redeploy", "gone") not in rates(
        model(plain), {}, [ActOutcome("gone", frozenset({"x"}), False)] * 9
    )


def test_a_power_cycle_has_a_rate_of_its_own() -> None:
    known = rates(model(), {}, ())
    plan = planned(known, bad="lidar")
    assert curing(plan, ["lidar"])["lidar"][0] == "power_cycle"
    assert cured(plan, ["lidar"]) == 0.5
    assert cured(plan, ["lidar"], known=known) == pytest.approx(0.8)


def test_the_reason_says_why() -> None:
    known = rates(
        model(), {"camera": "hard"}, [ActOutcome("camera", frozenset({"redeploy"}), True, "hard")] * 2
    )
    result = DiagnosisResult(
        model().components, (Diagnosis(("camera",), modes={"camera": "hard"}),), True, None, (), 0.0
    )
    situation = Situation(model(), (), result, rates=known)
    choice = situation.decide([planned(known)])
    assert choice.reason == (
        "camera: helps with probability 0.97 at cost 8; redeploy of camera 97% (95% given, 2 of 2 helped)"
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("restart: {soft: 0.9", "restart: {sift: 0.9", "none of its modes; did you mean `soft`"),
        ("power_cycle: 0.8", "power_cycle: 1", "between 0 and 1"),
        ("power_cycle: 0.8", "power_cycle: often", "between 0 and 1"),
    ],
)
def test_mistakes_are_refused(old: str, new: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        load_text(CAMERA.replace(old, new))


@given(st.floats(0.01, 0.99), st.integers(0, 200), st.integers(0, 200))
def test_a_rate_lies_between_what_is_given_and_what_was_seen(prior: float, helped: int, vain: int) -> None:
    mean = SuccessRate("restart", "camera", prior, True, helped, helped + vain).mean
    seen = helped / (helped + vain) if helped + vain else prior
    assert min(prior, seen) - 1e-9 <= mean <= max(prior, seen) + 1e-9
    assert abs(mean - seen) <= PRIOR_WEIGHT / (PRIOR_WEIGHT + helped + vain) + 1e-9
