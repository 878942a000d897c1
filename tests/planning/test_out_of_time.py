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
@pytest.mark.parametrize("questions", range(8))
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
    for exponent in range(-16, 4):
        forget()
        found = plan_for(robot, [], bad, replace(options, timeout_s=2.0**exponent))
        assert found.outcome in (true.outcome, Outcome.GAVE_UP)
        assert set(found.unreachable) <= set(true.unreachable)
    forget()
