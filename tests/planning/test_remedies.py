"""Remedies of the model: one action of the domain, planned with by each planner, each by its own name."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.planning.robots import texts

from robomend.diagnosis.result import Diagnosis, DiagnosisResult
from robomend.errors import DomainError, ModelError
from robomend.model.components import ComponentModel
from robomend.model.loading import load_text
from robomend.planning.advice import Situation, parts_of
from robomend.planning.domain.loading import load_domain, shipped
from robomend.planning.planning import PlanOptions, plan_for
from robomend.planning.problem import Offer, Offers, repair_problem
from robomend.planning.validation import validate
from robomend_client.literals import Atom, fails, holds
from robomend_client.readings import Symptom


def model(remedies: str, more: str = "") -> ComponentModel:
    text = f"""
robomend: 1
name: r
hardware: {{lidar: {{channel: 3}}}}
nodes:
  driver: {{drives: [lidar], publishes: {{scan: []}}}}
  planner: {{publishes: {{path: [scan]}}}}
  watcher: {{tied_to: [planner]}}
{more}
remedies:
{remedies}
"""
    return parts_of(load_text(text))


CLEAR = model("  clear_costmap: {mends: planner}")


def test_a_remedy_is_planned_by_its_own_name_before_a_dearer_restart(planner: str) -> None:
    plan = plan_for(CLEAR, [], ["planner"], PlanOptions(planner=planner))
    assert texts(plan) == ["clear_costmap(planner)"]
    assert plan.cost == 2
    other = PlanOptions(planner=planner, avoided=(("clear_costmap(planner)", "it did not help"),))
    assert {"stop_node(planner)", "start_node(planner)"} < set(texts(plan_for(CLEAR, [], ["planner"], other)))


def test_what_does_not_run_or_rests_on_what_is_bad_is_not_asked(planner: str) -> None:
    options = PlanOptions(planner=planner)
    stopped = plan_for(CLEAR, [fails("running", "planner")], ["planner"], options)
    assert "clear_costmap(planner)" not in texts(stopped)
    steps = plan_for(CLEAR, [], ["planner", "driver"], options).steps
    asked = next(step for step in steps if step.name == "clear_costmap")
    started = next(step for step in steps if str(step) == "start_node(driver)")
    assert started.index < asked.index
    assert started.index in asked.after


def test_a_remedy_says_what_must_restart_after_it_and_what_it_starts(planner: str) -> None:
    upsets = model("  reset_lidar: {mends: lidar, restarts: [driver]}")
    plan = plan_for(upsets, [], ["lidar"], PlanOptions(planner=planner))
    assert texts(plan) == ["reset_lidar(lidar)", "stop_node(driver)", "start_node(driver)"]
    unit = model("  restart_unit: {mends: planner, starts: true, cost: 1}")
    plan = plan_for(unit, [fails("running", "planner")], ["planner"], PlanOptions(planner=planner))
    assert "restart_unit(planner)" in texts(plan)
    assert holds("running", "planner") in plan.steps[0].effects


def test_an_act_with_parameters_of_its_own_mends_all_that_it_names() -> None:
    both = model('  "set_mode(base, low)": {mends: [planner, driver], cost: 1}')
    assert texts(plan_for(both, [], ["planner", "driver"])) == ["set_mode(base, low)"]
    assert plan_for(both, [], ["planner"]).steps[0].parameters == ("base", "low")


def test_device_that_is_off_is_not_mended_by_asking() -> None:
    reset = model("  reset_lidar: {mends: lidar}")
    assert texts(plan_for(reset, [fails("on", "lidar")], ["lidar"]))[0] == "power_up(lidar)"


def test_each_plan_holds_in_the_domain_as_written() -> None:
    domain = load_domain()
    for bad in (["planner"], ["driver", "planner"], ["lidar"], ["lidar", "planner"]):
        problem = repair_problem(CLEAR, domain, [], bad)
        steps = plan_for(CLEAR, [], bad).steps
        assert validate(domain, problem, [(s.name, s.parameters) for s in steps], problem.goal) is None


def test_what_is_protected_is_not_restarted_by_a_remedy_and_may_be_asked() -> None:
    protected = "  base: {protected: true, publishes: {odom: []}}"
    told = model("  reset_base: {mends: base}", protected)
    assert texts(plan_for(told, [], ["base"])) == ["reset_base(base)"]
    unit = model("  restart_unit: {mends: base, starts: true}", protected)
    plan = plan_for(unit, [], ["base"])
    assert not plan.steps
    assert "base is protected" in plan.unreachable[0]


def test_what_agents_offer_holds_for_each_by_its_name() -> None:
    there = Offers((Offer("onboard", None, frozenset({"start_node:planner"})),), frozenset({"clear_costmap"}))
    plan = plan_for(CLEAR, [], ["planner"], PlanOptions(offers=there))
    assert "clear_costmap(planner)" not in texts(plan)


def test_a_name_is_either_a_remedy_or_an_action_of_the_domain() -> None:
    own = """(define (domain robot-repair) (:action clear_costmap :parameters (?n - node)
      :precondition (bad ?n) :effect (and (good ?n) (not (bad ?n)))))"""
    with pytest.raises(DomainError, match="a remedy of the model, and an action"):
        plan_for(CLEAR, [], ["planner"], PlanOptions(domain=own))
    paper = PlanOptions(domain=shipped("paper-repair.pddl"))
    assert "clear_costmap" not in {step.name for step in plan_for(CLEAR, [], ["planner"], paper).steps}


def situation(remedies: str, *symptoms: tuple[str, Symptom]) -> Situation:
    parts = model(remedies)
    found = (Diagnosis(("planner",)),)
    result = DiagnosisResult(parts.components, found, True, None, (), 0.0)
    kinds = {Atom("ok", (topic,)): kind for topic, kind in symptoms}
    return Situation(parts, (fails("ok", "path"),), result, symptoms=kinds, cnf=None)


def test_the_kind_of_symptom_says_which_remedies_make_sense() -> None:
    still = "  clear_costmap: {mends: planner, symptoms: [still, value]}"
    assert situation(still, ("path", Symptom.STILL)).unfit == ()
    for other in (situation(still), situation(still, ("path", Symptom.SILENT))):
        ((act, why),) = other.unfit
        assert (act, why) == (
            "clear_costmap(planner)", "it is for still, value, and what is seen is silent"
        )  # fmt: skip
    assert situation("  clear_costmap: {mends: planner}").unfit == ()


def test_what_a_component_says_of_itself_is_mended_by_a_remedy_that_is_for_it() -> None:
    meant = situation(
        "  clear_costmap: {mends: planner, symptoms: [self-report]}", ("path", Symptom.SELF_REPORT)
    )
    parts = meant.model
    plan = plan_for(parts, [], ["planner"])
    assert texts(plan) == ["clear_costmap(planner)"]
    (alternative,) = meant.decide([plan]).alternatives
    unmeant = replace(meant, model=replace(parts, remedies=()))
    (other,) = unmeant.decide([plan]).alternatives
    assert alternative.helps >= other.helps


@pytest.mark.parametrize(
    ("written", "why"),
    [
        ("  clear_costmap: {mends: plan}", "no component is named `plan`"),
        ("  clear_costmap: {}", "needs `mends:`"),
        ("  clear costmap: {mends: planner}", "is no act: that is a name with its parameters"),
        ("  start_node: {mends: planner}", "an act of every robot"),
        ("  clear: {mends: planner, symptoms: [stil]}", "no symptom is named `stil`"),
        ("  clear: {mends: planner, restarts: [lidar]}", "no node is named `lidar`"),
        ("  clear: {mends: planner, restarts: [planner]}", "have it restarted"),
        ("  clear: {mends: [planner]}\n  clear(planner): {mends: planner}", "is there twice"),
    ],
)
def test_what_cannot_be_is_refused_with_its_line(written: str, why: str) -> None:
    with pytest.raises(ModelError, match=why) as refused:
        model(written)
    assert refused.value.line is not None


def test_the_domain_as_written_refuses_to_ask_what_does_not_run() -> None:
    domain = load_domain()
    problem = repair_problem(CLEAR, domain, [fails("running", "planner")], ["planner"])
    flaw = validate(domain, problem, [("clear_costmap", ("planner",))], problem.goal)
    assert flaw is not None
    assert flaw.condition == "running(planner)"
