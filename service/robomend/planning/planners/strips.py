"""A part as a Unified Planning problem: fluents without arguments, so that no engine needs to ground."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

from robomend.planning.decomposition import Part
from robomend.planning.plan import Outcome
from robomend.planning.planners import PartAnswer

# --- engines of Unified Planning, imported without what planning has no use for.
#
# Unified Planning and its engines import ConfigSpace for the name of one type, and that brings scipy.stats:
# more than four fifths of the time of the import. While an engine is made a stand-in has the name; who
# imports ConfigSpace afterwards gets the real one.

HEAVY = "ConfigSpace"


def oneshot_planner(name: str, **options: Any) -> Any:
    """Return an engine that plans, silent about its credits; ImportError without Unified Planning."""
    with _stand_in():
        from unified_planning.shortcuts import OneshotPlanner, get_environment

        get_environment().credits_stream = None
        return OneshotPlanner(name=name, **options)


@contextmanager
def _stand_in() -> Iterator[None]:
    if HEAVY in sys.modules:
        yield
        return
    module = ModuleType(HEAVY)
    vars(module)["ConfigurationSpace"] = type("ConfigurationSpace", (), {})
    sys.modules[HEAVY] = module
    try:
        yield
    finally:
        if sys.modules.get(HEAVY) is module:
            del sys.modules[HEAVY]


def up_problem(part: Part, *, costs: bool) -> Any:
    """Return the part as a `unified_planning.shortcuts.Problem`; action `a7` is the part's action 7.

    Fluents are named alike in every problem, so that Unified Planning's table of expressions, which never
    forgets, stays as small as the largest part.
    """
    from unified_planning.shortcuts import (
        BoolType,
        Fluent,
        InstantaneousAction,
        Int,
        MinimizeActionCosts,
        Problem,
    )

    fluents = [Fluent(f"f{index}", BoolType()) for index in range(part.facts)]
    problem = Problem("part")
    for fluent in fluents:
        problem.add_fluent(fluent, default_initial_value=False)
    paid: dict[Any, Any] = {}
    for number, one in enumerate(part.actions):
        action = InstantaneousAction(f"a{number}")
        for fact in sorted(one.needs):
            action.add_precondition(fluents[fact])
        for fact in sorted(one.adds):
            action.add_effect(fluents[fact], True)
        for fact in sorted(one.deletes - one.adds):
            action.add_effect(fluents[fact], False)
        problem.add_action(action)
        # Engines count in whole numbers: thousandths keep what users write.
        paid[action] = Int(round(one.cost * 1000))
    for fact in sorted(part.initial):
        problem.set_initial_value(fluents[fact], True)
    for fact in sorted(part.goal):
        problem.add_goal(fluents[fact])
    if costs:
        problem.add_quality_metric(MinimizeActionCosts(paid))
    return problem


def answer(result: Any, *, exhaustive: bool) -> PartAnswer:
    """Return what a `PlanGenerationResult` says, as ours.

    Args:
        exhaustive: it ends without a plan only when it has seen every state: that is a proof, though Unified
            Planning calls it UNSOLVABLE_INCOMPLETELY.
    """
    from unified_planning.engines import PlanGenerationResultStatus as Status

    if result.plan is not None:
        indices = tuple(int(instance.action.name[1:]) for instance in result.plan.actions)
        return PartAnswer(Outcome.SOLVED, indices)
    if result.status == Status.UNSOLVABLE_PROVEN:
        return PartAnswer(Outcome.UNSOLVABLE)
    if exhaustive and result.status == Status.UNSOLVABLE_INCOMPLETELY:
        return PartAnswer(Outcome.UNSOLVABLE)
    return PartAnswer(Outcome.GAVE_UP)
