"""Small computations on a part that several planners share."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from robomend.planning.decomposition import Part


def plan_cost(part: Part, plan: Sequence[int]) -> float:
    """Return the sum of the costs."""
    return sum(part.actions[index].cost for index in plan)


def reaches(part: Part, allowed: Collection[int]) -> bool:
    """Return whether the goal can be reached with these actions when nothing is ever deleted."""
    return relaxed_layers(part, allowed) is not None


def relaxed_layers(part: Part, allowed: Collection[int] | None = None) -> int | None:
    """Return how many parallel steps a plan takes at least (h_max), None if there is none."""
    facts = set(part.initial)
    waiting = list(range(len(part.actions)) if allowed is None else allowed)
    layers = 0
    while not part.goal <= facts:
        ready = [index for index in waiting if part.actions[index].needs <= facts]
        if not ready:
            return None
        facts.update(fact for index in ready for fact in part.actions[index].adds)
        done = set(ready)
        waiting = [index for index in waiting if index not in done]
        layers += 1
    return layers


def achieves(part: Part, plan: Sequence[int]) -> bool:
    """Return whether the plan can be carried out in this order and ends in the goal."""
    state = set(part.initial)
    for index in plan:
        action = part.actions[index]
        if not action.needs <= state:
            return False
        state -= action.deletes
        state |= action.adds
    return part.goal <= state


def without_redundant(part: Part, plan: Sequence[int]) -> tuple[int, ...]:
    """Return the plan with actions dropped that it can do without, dear ones first.

    An action is dropped together with those after it that can then no longer be carried out, if the goal is
    still reached.
    """
    kept = list(plan)
    for position in sorted(range(len(plan)), key=lambda one: -part.actions[plan[one]].cost):
        # Positions shift as actions go; an action that is gone already is skipped.
        candidate = _skip(part, kept, plan[position])
        if candidate is not None:
            kept = candidate
    return tuple(kept)


def _skip(part: Part, plan: Sequence[int], action: int) -> list[int] | None:
    """Return the plan without the first use of an action and what then fails; None if the goal is lost."""
    if action not in plan:
        return None
    dropped = plan.index(action)
    state = set(part.initial)
    kept: list[int] = []
    for position, index in enumerate(plan):
        one = part.actions[index]
        if position == dropped or not one.needs <= state:
            continue
        kept.append(index)
        state -= one.deletes
        state |= one.adds
    return kept if part.goal <= state else None
