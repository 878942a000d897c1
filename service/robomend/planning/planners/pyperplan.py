"""pyperplan through Unified Planning: the default for the small parts that decomposition leaves.

It plans for few actions, not for low cost, and takes no deadline: the worker process is killed at it. Its
time grows faster than the plan (12 steps 15 ms, 100 steps 2 s), hence `max_actions`.

The worst that ignoring costs can do is a short, dear action: "call the operator" instead of a restart. So
the plan is improved: redundant actions are dropped (action elimination), and it plans again without dear
actions wherever the goal can be reached without them.

pyperplan is GPLv3; it is imported only here, in the worker process.

Source: H. Nakhost, M. Müller. Action elimination and plan neighborhood graph search. ICAPS 2010.
"""

from __future__ import annotations

import logging
import warnings
from dataclasses import replace
from typing import Any

from robomend.errors import SolverError
from robomend.planning.decomposition import Part
from robomend.planning.plan import Outcome
from robomend.planning.planners import PartAnswer
from robomend.planning.planners.relaxed import plan_cost, reaches, without_redundant
from robomend.planning.planners.strips import answer, oneshot_planner, up_problem

MAX_RETRIES = 12
"""Calls to improve one part's plan."""


class Pyperplan:
    """Greedy best-first search with the FF heuristic."""

    name = "pyperplan"
    max_actions: int | None = 40

    def __init__(self) -> None:
        logging.getLogger().setLevel(max(logging.getLogger().level, logging.WARNING))
        params = {"search": "gbf", "heuristic": "hff"}
        try:
            self._engine: Any = oneshot_planner("pyperplan", params=params)
        except ImportError as error:
            raise SolverError(f"Unified Planning is not installed: {error}") from error
        self._engine.skip_checks = (
            True  # every part is STRIPS; computing `problem.kind` costs more than planning
        )

    def solve(self, part: Part, timeout_s: float | None) -> PartAnswer:
        """Return a short plan, made cheaper where that is easy."""
        everything = frozenset(range(len(part.actions)))
        found = self._search(part, everything)
        if found.outcome is not Outcome.SOLVED:
            return found
        best = without_redundant(part, found.actions)
        allowed = everything
        # All actions from some cost up: a single one would only be replaced by its like.
        for limit in sorted({action.cost for action in part.actions}, reverse=True)[:MAX_RETRIES]:
            fewer = frozenset(index for index in everything if part.actions[index].cost < limit)
            if not reaches(part, fewer):
                break
            best, allowed = self._cheaper(part, best, allowed, fewer)
        retries = MAX_RETRIES
        for dear in sorted(set(best), key=lambda index: (-part.actions[index].cost, index)):
            fewer = allowed - {dear}
            if retries and dear in best and reaches(part, fewer):
                retries -= 1
                best, allowed = self._cheaper(part, best, allowed, fewer)
        return PartAnswer(Outcome.SOLVED, best)

    def _cheaper(
        self, part: Part, best: tuple[int, ...], allowed: frozenset[int], fewer: frozenset[int]
    ) -> tuple[tuple[int, ...], frozenset[int]]:
        """Return the cheaper of the best and a plan of fewer actions, and what it may use."""
        other = self._search(part, fewer)
        if other.outcome is Outcome.SOLVED:
            plan = without_redundant(part, other.actions)
            if plan_cost(part, plan) < plan_cost(part, best):
                return plan, fewer
        return best, allowed

    def _search(self, part: Part, allowed: frozenset[int]) -> PartAnswer:
        kept = sorted(allowed)
        smaller = replace(part, actions=tuple(part.actions[index] for index in kept))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result = self._engine.solve(up_problem(smaller, costs=False))
        found = answer(result, exhaustive=True)
        return replace(found, actions=tuple(kept[index] for index in found.actions))
