"""Large parts in stages: supply first, then what it feeds; plans hold, and are cheapest on these robots."""

from __future__ import annotations

import pytest

from robomend.model.components import ComponentModel, Hardware, Node
from robomend.planning import planning
from robomend.planning.domain.loading import load_domain
from robomend.planning.plan import Outcome
from robomend.planning.planning import PlanOptions, forget, plan_for
from robomend.planning.problem import repair_problem
from robomend.planning.validation import validate
from robomend_bench.suites.plans import broken, random_robot, some_bad


def supply(devices: int) -> ComponentModel:
    """One power supply, devices behind it, a driver each."""
    names = [f"device{index}" for index in range(devices)]
    hardware = {name: Hardware(name, index, fed_by=("psu",)) for index, name in enumerate(names, 1)}
    nodes = {f"{name}_node": Node(f"{name}_node", (name,)) for name in names}
    return ComponentModel("supply", {"psu": Hardware("psu", 0), **hardware}, nodes, {}, channels=devices + 1)


@pytest.mark.parametrize("planner", ["pyperplan", "asp"])
def test_a_power_supply_that_hangs_is_cycled_and_whatever_it_feeds_comes_back_with_it(planner: str) -> None:
    robot = supply(40)
    plan = plan_for(robot, [], ["psu"], PlanOptions(planner=planner, timeout_s=60))
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
        options = PlanOptions(planner=planner, timeout_s=60)
        plans = []
        for limit in (1, 1000):
            monkeypatch.setattr(planning, "EXACT_UP_TO", limit)
            forget()
            plans.append(plan_for(robot, seen, bad, options))
        assert plans[0].cost == plans[1].cost
        assert plans[0].unreachable == plans[1].unreachable
