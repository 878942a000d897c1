"""encodings/plan.lp, through its planner: cheapest plans, proofs, and honest ends."""

from __future__ import annotations

import heapq
from itertools import count

from hypothesis import given
from hypothesis import strategies as st
from tests.examples import examples

from robomend.planning.decomposition import Part, PartAction
from robomend.planning.plan import Outcome
from robomend.planning.planners.asp import AspPlanner
from robomend.planning.planners.relaxed import achieves, plan_cost, relaxed_layers, without_redundant

FACTS = 5


def action(needs: str, adds: str, deletes: str = "", cost: float = 1.0) -> PartAction:
    def facts(text: str) -> frozenset[int]:
        return frozenset(int(letter) for letter in text)

    return PartAction(cost, facts(needs), facts(adds), facts(deletes) - facts(adds))


def part(initial: str, goal: str, *actions: PartAction) -> Part:
    return Part(FACTS, actions, frozenset(map(int, initial)), frozenset(map(int, goal)))


def dijkstra(problem: Part) -> float | None:
    tie = count()
    heap = [(0.0, next(tie), problem.initial)]
    done: set[frozenset[int]] = set()
    while heap:
        cost, _, state = heapq.heappop(heap)
        if state in done:
            continue
        done.add(state)
        if problem.goal <= state:
            return cost
        for one in problem.actions:
            if one.needs <= state:
                heapq.heappush(heap, (cost + one.cost, next(tie), (state - one.deletes) | one.adds))
    return None


def test_there_is_no_plan_although_the_relaxed_world_has_one() -> None:
    """Each goal costs the other its only support."""
    problem = part("0", "12", action("0", "1", "0"), action("0", "2", "0"))
    assert relaxed_layers(problem) == 1
    assert AspPlanner().solve(problem, 30).outcome is Outcome.UNSOLVABLE


def test_out_of_time_is_said() -> None:
    problem = part("0", "12", action("0", "1", "0"), action("0", "2", "0"))
    assert AspPlanner().solve(problem, 0.0).outcome is Outcome.GAVE_UP


facts = st.sets(st.integers(0, FACTS - 1), max_size=2)
actions = st.builds(
    lambda cost, needs, adds, deletes: PartAction(
        float(cost), frozenset(needs), frozenset(adds), frozenset(deletes - adds)
    ),
    st.integers(0, 6),
    facts,
    facts,
    facts,
)
problems = st.builds(
    lambda initial, goal, given: Part(FACTS, tuple(given), frozenset(initial), frozenset(goal)),
    facts,
    st.sets(st.integers(0, FACTS - 1), min_size=1, max_size=3),
    st.lists(actions, min_size=1, max_size=7),
)


@examples(150)
@given(problems)
def test_agrees_with_dijkstra_on_any_strips_problem(problem: Part) -> None:
    least = dijkstra(problem)
    answer = AspPlanner().solve(problem, 30)
    if least is None:
        assert answer.outcome is Outcome.UNSOLVABLE
    else:
        assert answer.outcome is Outcome.SOLVED
        assert achieves(problem, answer.actions)
        assert plan_cost(problem, answer.actions) == least


@given(problems, st.lists(st.integers(0, 6), max_size=8))
def test_dropping_redundant_actions_keeps_the_goal(problem: Part, walk: list[int]) -> None:
    state, plan = problem.initial, []
    for index in walk:
        if index < len(problem.actions) and problem.actions[index].needs <= state:
            plan.append(index)
            state = (state - problem.actions[index].deletes) | problem.actions[index].adds
    if problem.goal <= state:
        shorter = without_redundant(problem, plan)
        assert achieves(problem, shorter)
        assert plan_cost(problem, shorter) <= plan_cost(problem, plan)
