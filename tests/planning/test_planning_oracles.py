"""Plans of random robots against oracles: the domain as written, the cheapest plan, every order."""

from __future__ import annotations

import heapq
import random
from itertools import count, permutations, product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.planning.robots import PLANNERS, TEDUSAR

from robomend.model.components import ComponentModel, Hardware, Node
from robomend.planning import planning
from robomend.planning.domain.loading import load_domain
from robomend.planning.domain.values import Domain
from robomend.planning.ordering import layered
from robomend.planning.plan import Outcome, Plan
from robomend.planning.planning import PlanOptions, forget, plan_for
from robomend.planning.problem import Fact, RepairProblem, repair_problem
from robomend.planning.validation import validate
from robomend_bench.suites.plans import broken, random_robot, some_bad
from robomend_client.literals import fails


def replayed(robot: ComponentModel, plan: Plan, problem: RepairProblem, domain: Domain) -> None:
    """The plan holds in the domain as written, in its own order and in others that its order allows."""
    lost = {sentence.split(":")[0] for sentence in plan.unreachable}
    goal = [fact for fact in problem.goal if fact[1] not in lost]
    chance = random.Random(0)
    for _ in range(4):
        order: list[int] = []
        while len(order) < len(plan.steps):
            ready = [s.index for s in plan.steps if s.index not in order and set(s.after) <= set(order)]
            order.append(chance.choice(ready))
        named = [(plan.steps[i].name, plan.steps[i].parameters) for i in order]
        assert validate(domain, problem, named, goal) is None, robot
    serial = [(step.name, step.parameters) for step in plan.steps]
    assert validate(domain, problem, serial, goal) is None


def check_robot(seed: int, planner: str) -> None:
    robot = random_robot(seed, 6 + seed % 12)
    bad = some_bad(robot, 1 + seed % 5, seed) if seed % 4 else robot.components
    seen = broken(robot, bad, seed)
    plan = plan_for(robot, seen, bad, PlanOptions(planner=planner, timeout_s=300))
    domain = load_domain()
    replayed(robot, plan, repair_problem(robot, domain, seen, bad), domain)


def test_plans_for_random_robots_hold_in_the_domain_as_written(long: bool) -> None:
    for seed in range(200 if long else 40):
        check_robot(seed, PLANNERS[seed % 3])


def cheapest(domain: Domain, problem: RepairProblem, goal: frozenset[Fact]) -> float | None:
    """The oracle: Dijkstra over the states of the domain as written, knowing nothing of ground parts."""
    names = list(problem.objects)
    actions = [
        (schema, values)
        for schema in domain.schemas.values()
        for values in product(names, repeat=len(schema.parameters))
        if all(
            domain.is_a(problem.objects[value], kind)
            for value, (_, kind) in zip(values, schema.parameters, strict=True)
        )
    ]
    from robomend.planning.validation import _World

    world = _World(domain, problem)
    tie = count()
    heap = [(0.0, next(tie), problem.initial)]
    done: set[frozenset[Fact]] = set()
    while heap:
        cost, _, state = heapq.heappop(heap)
        if state in done:
            continue
        if goal <= state:
            return cost
        done.add(state)
        for schema, values in actions:
            env = {variable: value for (variable, _), value in zip(schema.parameters, values, strict=True)}
            if not world.true(schema.precondition, env, set(state)):
                continue
            adds: set[Fact] = set()
            deletes: set[Fact] = set()
            for effect in schema.effects:
                for binding in world.every(effect.variables, env):
                    if world.true(effect.condition, binding, set(state)):
                        (adds if effect.adds else deletes).add(world.fact(effect.atom, binding))
            following = (state - deletes) | adds
            if following not in done:
                heapq.heappush(heap, (cost + schema.cost, next(tie), following))
    return None


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000))
def test_asp_is_cheapest_and_pyperplan_within_a_tenth(seed: int) -> None:
    robot = random_robot(seed, 4)
    bad = some_bad(robot, 1 + seed % 4, seed)
    seen = broken(robot, bad, seed)
    domain = load_domain()
    problem = repair_problem(robot, domain, seen, bad)
    asp = plan_for(robot, seen, bad, PlanOptions(planner="asp", timeout_s=300))
    default = plan_for(robot, seen, bad, PlanOptions(timeout_s=300))
    lost = {sentence.split(":")[0] for sentence in asp.unreachable}
    goal = frozenset(fact for fact in problem.goal if fact[1] not in lost)
    least = cheapest(domain, problem, goal)
    assert least is not None
    assert asp.cost == least
    assert least <= default.cost <= 1.1 * least
    assert default.unreachable == asp.unreachable
    if asp.outcome is Outcome.UNSOLVABLE:
        # What was given up cannot be had: no plan reaches one lost goal more.
        for extra in problem.goal:
            if extra[1] in lost:
                assert cheapest(domain, problem, goal | {extra}) is None


def test_every_order_that_the_partial_order_allows_is_a_plan() -> None:
    """All of them, for a plan of five steps."""
    domain = load_domain()
    seen, bad = [fails("on", "jaguar")], ["jaguar", "rviz"]
    problem = repair_problem(TEDUSAR, domain, seen, bad)
    plan = plan_for(TEDUSAR, seen, bad)
    allowed = 0
    for order in permutations(range(len(plan.steps))):
        if any(order.index(other) > order.index(step.index) for step in plan.steps for other in step.after):
            continue
        allowed += 1
        named = [(plan.steps[i].name, plan.steps[i].parameters) for i in order]
        assert validate(domain, problem, named, problem.goal) is None
    assert allowed == 10  # a chain of three beside a chain of two


# --- steps as a partial order, and one order that keeps it


def test_where_the_order_is_free_low_ranks_come_first() -> None:
    assert layered([(), (), ()], lambda position: (-position,)) == [2, 1, 0]
    assert layered([(), (0,), ()], lambda position: (-position,)) == [2, 0, 1]


@given(st.lists(st.integers(0, 5), max_size=8), st.data())
def test_every_step_comes_once_and_after_what_it_comes_after(ranks: list[int], data: st.DataObject) -> None:
    after = [
        tuple(sorted(data.draw(st.sets(st.integers(0, position - 1))))) if position else ()
        for position in range(len(ranks))
    ]
    order = layered(after, lambda position: (ranks[position],))
    assert sorted(order) == list(range(len(ranks)))
    for position, before in enumerate(after):
        assert all(order.index(other) < order.index(position) for other in before)


# --- large parts in stages: supply first, then what it feeds


def supply(devices: int) -> ComponentModel:
    """One power supply, devices behind it, a driver each."""
    names = [f"device{index}" for index in range(devices)]
    hardware = {name: Hardware(name, index, fed_by=("psu",)) for index, name in enumerate(names, 1)}
    nodes = {f"{name}_node": Node(f"{name}_node", (name,)) for name in names}
    return ComponentModel("supply", {"psu": Hardware("psu", 0), **hardware}, nodes, {}, channels=devices + 1)


@pytest.mark.parametrize("planner", ["pyperplan", "asp"])
def test_a_power_supply_that_hangs_is_cycled_and_whatever_it_feeds_comes_back_with_it(planner: str) -> None:
    robot = supply(40)
    plan = plan_for(robot, [], ["psu"], PlanOptions(planner=planner, timeout_s=300))
    assert plan.outcome is Outcome.SOLVED
    assert plan.cost == 25 + 40 * 4  # the relays of the devices stay where they are
    named = [(step.name, step.parameters) for step in plan.steps]
    domain = load_domain()
    problem = repair_problem(robot, domain, [], ["psu"])
    assert validate(domain, problem, named, problem.goal) is None


@pytest.mark.parametrize("planner", ["pyperplan", "asp"])
def test_stages_cost_no_more_than_a_search_of_the_whole(
    planner: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for seed in range(12):
        robot = random_robot(seed, 6, awkward=seed % 2 == 0)
        bad = some_bad(robot, 2, seed)
        seen = broken(robot, bad, seed)
        options = PlanOptions(planner=planner, timeout_s=300)
        plans = []
        for limit in (1, 1000):
            monkeypatch.setattr(planning, "EXACT_UP_TO", limit)
            forget()
            plans.append(plan_for(robot, seen, bad, options))
        assert plans[0].cost == plans[1].cost
        assert plans[0].unreachable == plans[1].unreachable
