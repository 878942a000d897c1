"""The shipped domains: sound by their own rules, and read by Unified Planning as we read them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tests.planning.robots import ALL_OFF, POWER_UP, TEDUSAR

from robomend.planning.domain.formulas import Forall, atoms, negation_normal
from robomend.planning.domain.loading import load_domain, shipped
from robomend.planning.domain.values import PAIRS, Domain
from robomend.planning.plan import Plan
from robomend.planning.planning import PlanOptions, plan_for
from robomend_bench.suites.plans import broken, random_robot, some_bad

DOMAINS = {name: load_domain(shipped(name)) for name in ("repair.pddl", "paper-repair.pddl")}


@pytest.fixture(params=DOMAINS)
def domain(request: pytest.FixtureRequest) -> Domain:
    return DOMAINS[request.param]


def test_an_action_that_adds_a_fact_deletes_its_opposite(domain: Domain) -> None:
    for schema in domain.schemas.values():
        added = {(effect.atom.predicate, effect.atom.terms) for effect in schema.effects if effect.adds}
        deleted = {(effect.atom.predicate, effect.atom.terms) for effect in schema.effects if not effect.adds}
        for one, other in [*PAIRS, *((b, a) for a, b in PAIRS)]:
            if {one, other} <= domain.predicates.keys():
                for predicate, terms in added:
                    if predicate == one:
                        assert (other, terms) in deleted, (schema.name, one)


def test_quantifiers_and_conditions_are_guarded_by_static_predicates(domain: Domain) -> None:
    for schema in domain.schemas.values():
        for effect in schema.effects:
            assert {atom.predicate for atom in atoms(effect.condition)} <= domain.static
        parts = getattr(negation_normal(schema.precondition), "parts", ())
        for part in parts:
            if isinstance(part, Forall):
                assert any(atom.predicate in domain.static for atom in atoms(part.body))


def up_problem(plan: Plan, folder: Path) -> Any:
    from unified_planning.io import PDDLReader

    assert plan.pddl is not None
    (folder / "domain.pddl").write_text(plan.pddl[0])
    (folder / "problem.pddl").write_text(plan.pddl[1])
    return PDDLReader().parse_problem(str(folder / "domain.pddl"), str(folder / "problem.pddl"))


def up_says(plan: Plan, folder: Path) -> Any:
    """What Unified Planning's own validator says of the plan, read from the PDDL that we write."""
    from unified_planning.shortcuts import PlanValidator, get_environment

    get_environment().credits_stream = None
    problem = up_problem(plan, folder)
    from unified_planning.plans import ActionInstance, SequentialPlan

    actions = [
        ActionInstance(
            problem.action(step.name),
            tuple(
                problem.environment.expression_manager.ObjectExp(problem.object(name))
                for name in step.parameters
            ),
        )
        for step in plan.steps
    ]
    with PlanValidator(name="sequential_plan_validator") as validator:
        return validator.validate(problem, SequentialPlan(actions))


def test_unified_planning_accepts_the_power_up_plan_and_not_a_shorter_one(tmp_path: Path) -> None:
    from dataclasses import replace

    plan = plan_for(TEDUSAR, ALL_OFF, POWER_UP, PlanOptions(pddl=True))
    assert bool(up_says(plan, tmp_path))
    assert not bool(up_says(replace(plan, steps=plan.steps[1:]), tmp_path))


@pytest.mark.parametrize("seed", range(4))
def test_unified_planning_accepts_plans_for_random_robots(seed: int, tmp_path: Path) -> None:
    robot = random_robot(seed, 8, awkward=False)
    bad = some_bad(robot, 3, seed)
    plan = plan_for(robot, broken(robot, bad, seed), bad, PlanOptions(planner="asp", pddl=True))
    assert not plan.unreachable
    assert bool(up_says(plan, tmp_path))


def test_unified_planning_derives_the_same_order_for_power_up(tmp_path: Path) -> None:
    """Its partial-order plan of our plan, ground, has our layers."""
    from unified_planning.plans import ActionInstance, PlanKind, SequentialPlan
    from unified_planning.shortcuts import CompilationKind, Compiler, get_environment

    get_environment().credits_stream = None
    plan = plan_for(TEDUSAR, ALL_OFF, POWER_UP, PlanOptions(pddl=True))
    problem = up_problem(plan, tmp_path)
    with Compiler(name="up_quantifiers_remover") as compiler:
        problem = compiler.compile(problem, CompilationKind.QUANTIFIERS_REMOVING).problem
    with Compiler(name="up_grounder") as compiler:
        ground = compiler.compile(problem, CompilationKind.GROUNDING).problem
    names = {"_".join((step.name, *step.parameters)): str(step) for step in plan.steps}
    serial = SequentialPlan([ActionInstance(ground.action(name)) for name in names])
    partial = serial.convert_to(PlanKind.PARTIAL_ORDER_PLAN, ground)
    theirs = {
        (names[before.action.name], names[after.action.name])
        for before, follows in partial.get_adjacency_list.items()
        for after in follows
    }
    ours = {(str(plan.steps[i]), str(step)) for step in plan.steps for i in step.after}
    assert ours == theirs
