"""Cheapest plans of small parts, by seeing their states in order of cost (Dijkstra).

A device with its drivers has a few dozen states: seeing them all takes a millisecond, needs nothing to be
loaded, and ends in a cheapest plan or in the proof that there is none. So the service asks this planner
first, in its own process and with a bound in work (robomend.planning.planner_pool); the others get what is
too large for that.
"""

from __future__ import annotations

import heapq

from robomend.planning.decomposition import Part
from robomend.planning.plan import Outcome
from robomend.planning.planners import PartAnswer, processor_s
from robomend.planning.planners.relaxed import relaxed_layers
from robomend.planning.static_facts import UNBOUNDED, Work

MAX_STATES = 20_000


class Dijkstra:
    """Cheapest plans, of equally cheap ones one with the fewest actions; GAVE_UP beyond MAX_STATES.

    Args:
        work: what it may do for all parts together: a step is an action that is looked at in a state.
    """

    name = "dijkstra"
    max_actions: int | None = None

    def __init__(self, work: Work = UNBOUNDED) -> None:
        self._work = work

    def solve(self, part: Part, timeout_s: float | None) -> PartAnswer:
        """Return a cheapest plan.

        Raises:
            OutOfWork: that would take more work than is left.
        """
        deadline = None if timeout_s is None else processor_s() + timeout_s
        return dijkstra(part, deadline=deadline, work=self._work)


def dijkstra(part: Part, *, deadline: float | None, work: Work = UNBOUNDED) -> PartAnswer:
    """Return a cheapest plan, or the proof that there is none; GAVE_UP after MAX_STATES, or late."""
    if relaxed_layers(part) is None:
        return PartAnswer(Outcome.UNSOLVABLE)
    paths: dict[frozenset[int], tuple[int, frozenset[int]] | None] = {part.initial: None}
    costs = {part.initial: (0.0, 0)}
    pending = [(0.0, 0, 0, part.initial)]
    settled: set[frozenset[int]] = set()
    pushed = 0  # breaks ties, as sets have no order
    while pending:
        cost, length, _, state = heapq.heappop(pending)
        if state in settled:
            continue
        if part.goal <= state:
            return PartAnswer(Outcome.SOLVED, _path(paths, state))
        settled.add(state)
        if len(settled) > MAX_STATES or (deadline is not None and processor_s() > deadline):
            return PartAnswer(Outcome.GAVE_UP)
        work.spend(len(part.actions))
        for index, action in enumerate(part.actions):
            if not action.needs <= state:
                continue
            following = (state - action.deletes) | action.adds
            total = (cost + action.cost, length + 1)
            if following not in costs or total < costs[following]:
                costs[following] = total
                paths[following] = (index, state)
                pushed += 1
                heapq.heappush(pending, (*total, pushed, following))
    return PartAnswer(Outcome.UNSOLVABLE)


def _path(
    paths: dict[frozenset[int], tuple[int, frozenset[int]] | None], state: frozenset[int]
) -> tuple[int, ...]:
    """Return the actions that led to a state."""
    actions = []
    while (step := paths[state]) is not None:
        index, state = step
        actions.append(index)
    return tuple(reversed(actions))
