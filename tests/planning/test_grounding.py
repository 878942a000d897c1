"""Grounding and splitting: few actions, nothing lost, any shape of condition."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.planning.robots import ALL_OFF, POWER_UP, TEDUSAR, texts

from robomend.errors import DomainError
from robomend.model.components import ComponentModel, Node
from robomend.planning import grounding
from robomend.planning.decomposition import split
from robomend.planning.domain.formulas import Is
from robomend.planning.domain.loading import load_domain
from robomend.planning.grounding import Grounder, GroundProblem
from robomend.planning.plan import Outcome
from robomend.planning.planning import PlanOptions, plan_for
from robomend.planning.problem import repair_problem
from robomend.planning.relevance import ground
from robomend.planning.static_facts import StaticFacts
from robomend_client.literals import Literal, fails, holds


def grounded(observed: tuple[Literal, ...], bad: tuple[str, ...]) -> GroundProblem:
    domain = load_domain()
    problem = repair_problem(TEDUSAR, domain, observed, bad)
    grounder = Grounder(domain, problem)
    return ground(grounder, [grounder.number(fact) for fact in problem.goal])


def test_only_what_can_help_is_grounded() -> None:
    problem = grounded((fails("on", "jaguar"),), ("jaguar",))
    assert {str(action) for action in problem.actions} == {
        "power_up(jaguar)",
        "shutdown(jaguar)",
        "start_node(jaguar_node)",
        "stop_node(jaguar_node)",
    }


def test_devices_are_parts_of_their_own_and_equal_ones_are_equal_values() -> None:
    parts = split(grounded(ALL_OFF, POWER_UP))
    assert len(parts) == 9
    assert len({part.part for part in parts}) == 2
    assert max(len(part.actions) for part in parts) == 4


SHAPES = """
(define (domain robot-repair)
  (:types tool - object)
  (:predicates (held ?t - tool) (fits ?t - tool ?n - node) (clean ?n - node))
  (:constants hammer wrench - tool)
  (:action take :parameters (?t - tool)
    :precondition (not (exists (?o - tool) (and (held ?o) (not (= ?o ?t)))))
    :effect (and (held ?t) (increase (total-cost) 1)))
  (:action drop :parameters (?t - tool) :precondition (held ?t)
    :effect (and (not (held ?t)) (increase (total-cost) 1)))
  (:action hit :parameters (?n - node)
    :precondition (and (bad ?n) (or (held wrench) (and (held hammer) (not (clean ?n)))))
    :effect (and (good ?n) (not (bad ?n)) (clean ?n) (increase (total-cost) 1)))
  (:init (held wrench) (clean b)))
"""


@pytest.mark.parametrize("planner", ["pyperplan", "asp"])
def test_negation_disjunction_and_quantifiers_are_understood(planner: str) -> None:
    robot = ComponentModel("r", {}, {name: Node(name, restartable=False) for name in "ab"}, {})
    options = PlanOptions(planner=planner, domain=SHAPES)
    assert texts(plan_for(robot, [], ["a"], options)) == ["hit(a)"]
    empty_handed = PlanOptions(planner=planner, domain=SHAPES.replace("(held wrench) (clean b)", "(clean b)"))
    assert len(plan_for(robot, [], ["b"], empty_handed).steps) == 2
    # Only a hammer, which must not touch what is clean, and no way to put it down: no plan, and it is proved.
    stuck = SHAPES.replace("(held wrench) (clean b)", "(held hammer) (clean b)").replace(
        ":precondition (held ?t)", ":precondition (and (held ?t) (= ?t wrench))"
    )
    hammer = PlanOptions(planner=planner, domain=stuck)
    assert texts(plan_for(robot, [], ["a"], hammer)) == ["hit(a)"]  # the other one of the disjunction
    plan = plan_for(robot, [], ["b"], hammer)
    assert plan.outcome is Outcome.UNSOLVABLE
    assert plan.unreachable[0].startswith("b: ")


def test_what_is_observed_of_the_users_own_predicates_is_in_the_initial_state() -> None:
    text = SHAPES.replace("(held wrench) (clean b)", "")
    robot = ComponentModel("r", {}, {"a": Node("a", restartable=False)}, {})
    assert len(plan_for(robot, [], ["a"], PlanOptions(domain=text)).steps) == 2
    seen = [holds("held", "wrench")]
    assert texts(plan_for(robot, seen, ["a"], PlanOptions(domain=text))) == ["hit(a)"]


WIDE = """
(define (domain robot-repair)
  (:action juggle :parameters (?a ?b ?c ?d - node) :precondition (bad ?a)
    :effect (and (good ?a) (not (bad ?a)))))
"""


def test_an_action_with_too_many_instances_is_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grounding, "MAX_GROUND_ACTIONS", 500)
    with pytest.raises(DomainError, match="guard the parameters of 'juggle'"):
        plan_for(TEDUSAR, [], ["rviz"], PlanOptions(domain=WIDE, domain_file="mine.pddl"))


RELATED = """
(define (domain robot-repair)
  (:types thing)
  (:predicates (p ?a ?b - thing) (q ?a ?b - thing)))
"""


@given(st.data())
def test_bindings_are_never_more_than_were_counted(data: st.DataObject) -> None:
    names = [f"o{index}" for index in range(4)]
    drawn = st.tuples(st.sampled_from(["p", "q"]), st.sampled_from(names), st.sampled_from(names))
    facts = data.draw(st.frozensets(drawn, max_size=8))
    variables = tuple((f"?{index}", "thing") for index in range(data.draw(st.integers(0, 3))))
    terms = st.sampled_from([*(name for name, _ in variables), *names])
    guards = [
        Is(predicate, (one, other))
        for predicate, one, other in data.draw(
            st.lists(st.tuples(st.sampled_from(["p", "q"]), terms, terms), max_size=3)
        )
    ]
    env = {name: data.draw(st.sampled_from(names)) for name, _ in variables if data.draw(st.booleans())}
    domain = load_domain(RELATED)
    problem = replace(
        repair_problem(TEDUSAR, domain, (), ()), objects=dict.fromkeys(names, "thing"), initial=facts
    )
    static = StaticFacts(domain, problem)
    made = [tuple(sorted(found.items())) for found in static.bindings(variables, guards, env)]
    assert len(set(made)) <= static.most_bindings(variables, guards, env)


def test_where_one_of_several_conditions_always_holds_the_others_make_no_actions() -> None:
    text = SHAPES.replace("(held wrench) (and", "(and (= ?n ?n) (= hammer hammer)) (held wrench) (and", 1)
    robot = ComponentModel("r", {}, {name: Node(name, restartable=False) for name in "ab"}, {})
    domain = load_domain(text)
    problem = repair_problem(robot, domain, (), ("a",))
    grounder = Grounder(domain, problem)
    actions = ground(grounder, [grounder.number(fact) for fact in problem.goal]).actions
    assert [str(action) for action in actions] == ["hit(a)"]
