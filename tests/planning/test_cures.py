"""How probably a plan cures what it is for, and which of two ways to cure it comes first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from tests.planning.robots import TEDUSAR, texts

from robomend.diagnosis.result import Diagnosis
from robomend.planning.choice import Candidate, choose
from robomend.planning.cures import CURES, Avoided, Cure, best_way, cured, once
from robomend.planning.plan import Outcome, Plan
from robomend.planning.planning import PlanOptions, plan_for, plans_for
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


def planned(cost: int | None, *observed: Literal, avoided: str = "") -> Plan:
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
    assert texts(planned(cost)) == steps


def test_a_spare_that_was_no_help_leaves_the_power_cycle() -> None:
    assert texts(planned(30, avoided="switch_to_spare(hokuyo, jaguar)")) == CYCLE


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
        choice = choose([restart, Candidate(Diagnosis(("hokuyo",)), planned(cost))])
        assert choice.plan is restart.plan
        assert choice.alternatives[1].reason == words


def test_of_a_power_cycle_the_cut_is_done_once_and_of_another_cure_the_act() -> None:
    assert once(plan_for(TEDUSAR, [], ["hokuyo"]), {"hokuyo"}) == {"shutdown(hokuyo)"}
    assert once(planned(30), {"hokuyo"}) == {"switch_to_spare(hokuyo, jaguar)"}
    assert once(planned(30), set()) == set()


def test_what_is_off_may_be_switched_on_and_a_process_restarted_again() -> None:
    assert once(plan_for(TEDUSAR, [fails("on", "hokuyo")], ["hokuyo"]), {"hokuyo"}) == set()
    assert once(plan_for(TEDUSAR, [], ["hokuyo_node"]), set()) == set()
