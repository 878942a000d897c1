"""Planners one by one: the ASP planner against Dijkstra, Fast Downward, what pyperplan says."""

from __future__ import annotations

import heapq
import subprocess
import sys
from itertools import count

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.examples import examples

from robomend.planning.decomposition import Part, PartAction
from robomend.planning.plan import Outcome
from robomend.planning.planners.asp import AspPlanner
from robomend.planning.planners.relaxed import achieves, plan_cost, relaxed_layers, without_redundant

FACTS = 5


def counter(bits: int) -> Part:
    """All bits are to be 1, counted up one by one: 2**bits - 1 steps, where `bits` seem enough."""
    below = [frozenset(range(bit)) for bit in range(bits)]
    actions = [PartAction(1.0, below[bit], frozenset({bit}), below[bit]) for bit in range(bits)]
    return Part(bits, tuple(actions), frozenset(), frozenset(range(bits)))


def test_a_long_plan_that_ends_in_the_goal_and_nothing_else_is_found() -> None:
    answer = AspPlanner().solve(counter(4), 60)
    assert answer.outcome is Outcome.SOLVED
    assert len(answer.actions) == 15


def test_that_no_plan_exists_is_proved_where_the_lower_bound_does_not_see_it_and_out_of_time_is_said() -> (
    None
):
    """Each goal costs the other its only support."""
    either = (
        PartAction(1.0, frozenset({0}), frozenset({1}), frozenset({0})),
        PartAction(1.0, frozenset({0}), frozenset({2}), frozenset({0})),
    )
    problem = Part(3, either, frozenset({0}), frozenset({1, 2}))
    assert relaxed_layers(problem) == 1
    assert AspPlanner().solve(problem, 60).outcome is Outcome.UNSOLVABLE
    assert AspPlanner().solve(problem, 0.0).outcome is Outcome.GAVE_UP


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


# --- Fast Downward, where it is not installed

STARTER = """
import resource, signal, subprocess, sys
from robomend.planning.planners.fast_downward import children_end_after

before = resource.getrlimit(resource.RLIMIT_CPU)
with children_end_after(0.1):
    child = subprocess.Popen([sys.executable, "-c", "while True: pass"])
assert resource.getrlimit(resource.RLIMIT_CPU) == before
try:
    assert child.wait(100) == -signal.SIGXCPU
finally:
    child.kill()
    child.wait()
"""
"""A process of its own: what a starter has used comes on top, and a test worker may have used minutes."""


def test_what_is_started_within_ends_by_itself_when_its_cpu_time_is_used_up() -> None:
    subprocess.run([sys.executable, "-c", STARTER], check=True, timeout=115)


@pytest.mark.parametrize(("before", "after"), [("NOTSET", "WARNING"), ("ERROR", "ERROR")])
def test_the_planner_that_logs_each_step_of_its_search_says_only_what_is_worth_a_warning(
    before: str, after: str
) -> None:
    code = (
        "import logging; from robomend.planning.planner_pool import warm; warm(('pyperplan',)); "
        "from robomend.planning.planners.pyperplan import Pyperplan; "
        f"logging.root.setLevel({before!r}); Pyperplan(); "
        f"assert logging.getLevelName(logging.root.level) == {after!r}"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=110)
