"""Planning in worker processes: planners that hang, crash, lie or exhaust memory end only themselves."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.distributions import install
from tests.planning.robots import ALL_OFF, POWER_UP, TEDUSAR, texts
from tests.workers.conftest import workers_from_nothing

from robomend.errors import DomainError, SolverError, WorkerDied
from robomend.planning.plan import Outcome
from robomend.planning.planner_pool import PlannerPool
from robomend.planning.planning import PlanOptions
from robomend_client.literals import fails

__all__ = ["workers_from_nothing"]  # a fixture of all tests here


CODE = '''
import os, signal
from robomend.errors import SolverError
from robomend.model.components import ComponentModel, Hardware, Node
from robomend.planning.plan import Outcome
from robomend.planning.planners import PartAnswer

class Base:
    max_actions = None
    def __init__(self): self.name = type(self).__name__
class Hangs(Base):
    def solve(self, part, timeout_s):
        while True: pass
class Crashes(Base):
    def solve(self, part, timeout_s): os.kill(os.getpid(), signal.SIGSEGV)
class Hogs(Base):
    def solve(self, part, timeout_s): return bytearray(1 << 36)
class Lies(Base):
    def solve(self, part, timeout_s): return PartAnswer(Outcome.SOLVED, ())
class Refuses(Base):
    def solve(self, part, timeout_s): raise SolverError("I do not feel like it")
class Backwards(Base):
    """A planner of a third party that works: brute force."""
    def solve(self, part, timeout_s):
        frontier = {part.initial: ()}
        seen = set(frontier)
        while frontier:
            following = {}
            for state, plan in frontier.items():
                if part.goal <= state: return PartAnswer(Outcome.SOLVED, plan)
                for index, action in enumerate(part.actions):
                    new = (state - action.deletes) | action.adds
                    if action.needs <= state and new not in seen:
                        seen.add(new)
                        following[new] = (*plan, index)
            frontier = following
        return PartAnswer(Outcome.UNSOLVABLE)
'''

NAMES = ("Hangs", "Crashes", "Hogs", "Lies", "Refuses", "Backwards")


@pytest.fixture(scope="module")
def pool(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PlannerPool]:
    """Worker processes that see a distribution with planners of a third party."""
    points = {"robomend.planners": {name.lower(): name for name in NAMES}}
    folder = install(tmp_path_factory.mktemp("third_party"), "odd_planners", CODE, points)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        planners = PlannerPool(size=1, spare=1, at_once=False)
        planners.start()
        yield planners
        pids = planners.pids
        planners.close()
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)


def plan(pool: PlannerPool, planner: str, timeout_s: float = 300.0) -> list[str]:
    options = PlanOptions(planner=planner, timeout_s=timeout_s)
    found = pool.plans_now(TEDUSAR, [fails("on", "jaguar")], [["jaguar"]], options)[0]
    assert found.outcome is Outcome.SOLVED
    return texts(found)


JAGUAR = ["power_up(jaguar)", "stop_node(jaguar_node)", "start_node(jaguar_node)"]


@pytest.mark.parametrize("planner", ["pyperplan", "asp", "backwards"])
def test_planners_plan_in_workers(pool: PlannerPool, planner: str) -> None:
    assert plan(pool, planner) == JAGUAR


@pytest.mark.parametrize("planner", ["crashes", "hogs", "lies", "refuses"])
def test_a_planner_that_fails_is_stood_in_for(pool: PlannerPool, planner: str) -> None:
    assert plan(pool, planner) == JAGUAR


def test_a_planner_that_hangs_is_killed_and_stood_in_for(pool: PlannerPool) -> None:
    assert plan(pool, "hangs", timeout_s=4.0) == JAGUAR


def test_without_time_left_the_answer_is_that_it_gave_up(pool: PlannerPool) -> None:
    pool.plans_now(TEDUSAR, ALL_OFF, [POWER_UP], PlanOptions())
    options = PlanOptions(planner="hangs", timeout_s=0.05)
    found = pool.plans_now(TEDUSAR, ALL_OFF, [POWER_UP], options)[0]
    assert found.outcome is Outcome.GAVE_UP
    assert found.steps == ()


def test_what_is_wrong_with_the_input_comes_back_as_such(pool: PlannerPool) -> None:
    options = PlanOptions(domain="(define (domain robot-repair) (:action a))", domain_file="mine.pddl")
    with pytest.raises(DomainError) as caught:
        pool.plans_now(TEDUSAR, [], [["jaguar"]], options)
    assert str(caught.value).startswith("mine.pddl:1: ")


def test_when_nothing_works_the_error_is_the_workers() -> None:
    """So little memory that not even the fallback can start."""
    planners = PlannerPool(size=1, spare=0, memory_bytes=40 << 20, at_once=False)
    try:
        with pytest.raises((WorkerDied, SolverError)):
            planners.plans_now(TEDUSAR, [], [["jaguar"]], PlanOptions())
    finally:
        planners.close()


def test_a_small_problem_needs_no_worker_which_takes_long_to_start_on_a_busy_computer() -> None:
    planners = PlannerPool(size=1, spare=0, memory_bytes=40 << 20)  # in which none can start
    try:
        [found] = planners.plans_now(TEDUSAR, [fails("on", "jaguar")], [["jaguar"]], PlanOptions())
        assert texts(found) == JAGUAR
        assert planners.pids == ()
    finally:
        planners.close()
