"""Out of time is never taken for a proof, wherever the time runs out."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.planning.robots import POWER_UP, TEDUSAR
from tests.planning.test_planning_user_actions import LENS

from robomend.model.components import ComponentModel, Hardware, Node
from robomend.planning.decomposition import Part
from robomend.planning.plan import Outcome
from robomend.planning.planners import PartAnswer
from robomend.planning.planners.asp import AspPlanner
from robomend.planning.planning import PlanOptions, forget, plan_for
from robomend.planning.static_facts import OutOfWork, Work

Trouble = tuple[ComponentModel, tuple[str, ...], str | None]

TROUBLES: list[Trouble] = [
    # To cycle the arm breaks its driver, which nobody can restart: one of the two goals must be given up.
    (
        ComponentModel(
            "arm", {"arm": Hardware("arm", 1)}, {"driver": Node("driver", ("arm",), restartable=False)}, {}
        ),
        ("arm",),
        None,
    ),
    (
        ComponentModel("cam", {"arm": Hardware("arm"), "cam": Hardware("cam", fed_by=("arm",))}, {}, {}),
        ("arm", "cam"),
        LENS,
    ),
    (TEDUSAR, POWER_UP, None),
]


@pytest.mark.parametrize("trouble", TROUBLES)
@pytest.mark.parametrize("questions", [0, 1, 3, 7])
def test_a_planner_that_gives_up_anywhere_proves_nothing(
    trouble: Trouble, questions: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, bad, domain = trouble
    options = PlanOptions(planner="asp", timeout_s=None, domain=domain)
    true = plan_for(robot, [], bad, options)
    left = iter(range(questions))
    solve = AspPlanner.solve

    def tired(planner: AspPlanner, part: Part, timeout_s: float | None) -> PartAnswer:
        return PartAnswer(Outcome.GAVE_UP) if next(left, None) is None else solve(planner, part, timeout_s)

    monkeypatch.setattr(AspPlanner, "solve", tired)
    forget()
    found = plan_for(robot, [], bad, options)
    forget()
    if (found.outcome, found.unreachable) != (true.outcome, true.unreachable):
        assert found.outcome is Outcome.GAVE_UP
        assert found.steps == ()
        assert set(found.unreachable) <= set(true.unreachable)


@pytest.mark.parametrize("trouble", TROUBLES)
def test_at_every_time_limit_the_answer_is_the_true_one_or_that_the_time_was_up(trouble: Trouble) -> None:
    robot, bad, domain = trouble
    options = PlanOptions(planner="asp", timeout_s=None, domain=domain)
    true = plan_for(robot, [], bad, options)
    for exponent in range(-16, 4, 3):
        forget()
        found = plan_for(robot, [], bad, replace(options, timeout_s=2.0**exponent))
        assert found.outcome in (true.outcome, Outcome.GAVE_UP)
        assert set(found.unreachable) <= set(true.unreachable)
    forget()


@pytest.mark.parametrize("trouble", TROUBLES)
def test_at_every_bound_of_work_the_answer_is_the_true_one_or_none(trouble: Trouble) -> None:
    robot, bad, domain = trouble
    options = PlanOptions(planner="asp", timeout_s=None, domain=domain)
    true = plan_for(robot, [], bad, options)
    answers: set[str | None] = set()
    for most in (*range(0, 500, 19), 2_000, 20_000):
        forget()
        try:
            found = plan_for(robot, [], bad, options, Work(most))
        except OutOfWork:
            answers.add(None)
            continue
        answers.add(found.planner)
        assert (found.outcome, found.unreachable, found.cost) == (true.outcome, true.unreachable, true.cost)
    assert answers == {None, "dijkstra"}
    forget()


TWO_WAYS = """
(define (domain robot-repair)
  (:action dear :parameters (?h - hardware) :precondition (bad ?h)
    :effect (and (good ?h) (not (bad ?h)) (increase (total-cost) 9)))
  (:action cheap :parameters (?h - hardware) :precondition (bad ?h)
    :effect (and (good ?h) (not (bad ?h)) (increase (total-cost) 1))))
"""


def test_the_best_plan_until_the_time_was_up_is_not_remembered_for_who_has_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    options = PlanOptions(planner="asp", timeout_s=0.0, domain=TWO_WAYS)

    def hurried(planner: AspPlanner, part: Part, timeout_s: float | None) -> PartAnswer:
        dear = max(range(len(part.actions)), key=lambda index: part.actions[index].cost)
        return PartAnswer(Outcome.SOLVED, (dear,))

    forget()
    with monkeypatch.context() as late:
        late.setattr(AspPlanner, "solve", hurried)
        assert plan_for(TEDUSAR, [], ["imu"], options).steps[0].name == "dear"
    assert plan_for(TEDUSAR, [], ["imu"], replace(options, timeout_s=None)).steps[0].name == "cheap"
    forget()
