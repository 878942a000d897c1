"""Planners one by one: the ASP planner on long plans, Fast Downward, what pyperplan says."""

from __future__ import annotations

import subprocess
import sys

import pytest

from robomend.planning.decomposition import Part, PartAction
from robomend.planning.plan import Outcome
from robomend.planning.planners.asp import AspPlanner


def counter(bits: int) -> Part:
    """All bits are to be 1, counted up one by one: 2**bits - 1 steps, where `bits` seem enough."""
    below = [frozenset(range(bit)) for bit in range(bits)]
    actions = [PartAction(1.0, below[bit], frozenset({bit}), below[bit]) for bit in range(bits)]
    return Part(bits, tuple(actions), frozenset(), frozenset(range(bits)))


def test_a_long_plan_that_ends_in_the_goal_and_nothing_else_is_found() -> None:
    answer = AspPlanner().solve(counter(4), 60)
    assert answer.outcome is Outcome.SOLVED
    assert len(answer.actions) == 15


def test_that_no_plan_exists_is_proved_where_the_lower_bound_does_not_see_it() -> None:
    either = (
        PartAction(1.0, frozenset({0}), frozenset({1}), frozenset({0})),
        PartAction(1.0, frozenset({0}), frozenset({2}), frozenset({0})),
    )
    answer = AspPlanner().solve(Part(3, either, frozenset({0}), frozenset({1, 2})), 60)
    assert answer.outcome is Outcome.UNSOLVABLE


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
