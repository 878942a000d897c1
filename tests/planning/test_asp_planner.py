"""The ASP planner on parts whose plans are far longer than their lower bound."""

from __future__ import annotations

from robomend.planning.decomposition import Part, PartAction
from robomend.planning.plan import Outcome
from robomend.planning.planners.asp import AspPlanner


def counter(bits: int) -> Part:
    """All bits are to be 1, counted up one by one: 2**bits - 1 steps, where `bits` seem enough."""
    below = [frozenset(range(bit)) for bit in range(bits)]
    actions = [PartAction(1.0, below[bit], frozenset({bit}), below[bit]) for bit in range(bits)]
    return Part(bits, tuple(actions), frozenset(), frozenset(range(bits)))


def test_a_long_plan_that_ends_in_the_goal_and_nothing_else_is_found_and_cheapest() -> None:
    answer = AspPlanner().solve(counter(4), 60)
    assert answer.outcome is Outcome.SOLVED
    assert answer.cheapest
    assert len(answer.actions) == 15


def test_that_no_plan_exists_is_proved_where_the_lower_bound_does_not_see_it() -> None:
    either = (
        PartAction(1.0, frozenset({0}), frozenset({1}), frozenset({0})),
        PartAction(1.0, frozenset({0}), frozenset({2}), frozenset({0})),
    )
    answer = AspPlanner().solve(Part(3, either, frozenset({0}), frozenset({1, 2})), 60)
    assert answer.outcome is Outcome.UNSOLVABLE
