"""Plan a large part stage by stage: what feeds others first, then what is fed.

    power supply ──► devices that it feeds ──► their drivers

A power supply that is cycled takes everything behind it down, so all of that is one part, too large for a
planner that searches for the cheapest plan. Its actions still depend on each other in one direction. A
stage is a strongly connected component of "writes what the other needs"; stages are planned in order, each
from the state that those before it leave behind, for the goals that no later stage brings about.

Every step is planned in the state that it will find, so the result is a plan or there is none (None: the
caller searches the whole part). It need not be a cheapest one: a dearer supply-side plan that spares the
devices is not seen.

Source: as decomposition.py; serialisable subgoals, R. Korf. Planning as search. AIJ 33, 1987.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable

from robomend.model.loops import strong_components
from robomend.planning.decomposition import Part, PartAction
from robomend.planning.plan import Outcome
from robomend.planning.planners import PartAnswer


def in_series(part: Part, solve: Callable[[Part], PartAnswer]) -> tuple[int, ...] | None:
    """Return a plan as indices of the part's actions, None when planning in stages does not get there."""
    order = stages(part)
    if len(order) < 2:
        return None
    last: dict[int, int] = {}  # fact -> the last stage that can achieve it
    for number, stage in enumerate(order):
        for index in stage:
            last.update(dict.fromkeys(part.actions[index].adds, number))
    state = set(part.initial)
    plan: list[int] = []
    for number, stage in enumerate(order):
        written: dict[int, int] = {}
        for index in stage:
            action = part.actions[index]
            for fact in (*sorted(action.needs), *sorted(action.adds), *sorted(action.deletes)):
                written.setdefault(fact, len(written))
        changed = {fact for index in stage for fact in part.actions[index].adds | part.actions[index].deletes}
        goal = {fact for fact in part.goal & changed if last.get(fact, -1) <= number}
        if goal <= state:
            continue
        usable = [index for index in stage if part.actions[index].needs - changed <= state]
        answer = solve(
            Part(
                len(written),
                tuple(_renumbered(part.actions[index], written) for index in usable),
                frozenset(written[fact] for fact in written if fact in state),
                frozenset(written[fact] for fact in goal),
            )
        )
        if answer.outcome is not Outcome.SOLVED:
            return None
        for chosen in answer.actions:
            action = part.actions[usable[chosen]]
            state -= action.deletes
            state |= action.adds
            plan.append(usable[chosen])
    return tuple(plan) if part.goal <= state else None


def stages(part: Part) -> list[list[int]]:
    """Return the actions in groups such that no group writes what an earlier one needs."""
    writers: dict[int, list[str]] = defaultdict(list)
    for index, action in enumerate(part.actions):
        for fact in action.adds | action.deletes:
            writers[fact].append(str(index))
    waits_for = {
        str(index): sorted({writer for fact in action.needs for writer in writers[fact]}, key=int)
        for index, action in enumerate(part.actions)
    }
    numbers = strong_components(waits_for)
    groups: dict[int, list[int]] = defaultdict(list)
    for index in range(len(part.actions)):
        groups[numbers[str(index)]].append(index)
    return [groups[number] for number in sorted(groups)]


def _renumbered(action: PartAction, numbers: dict[int, int]) -> PartAction:
    return PartAction(
        action.cost,
        frozenset(numbers[fact] for fact in action.needs),
        frozenset(numbers[fact] for fact in action.adds),
        frozenset(numbers[fact] for fact in action.deletes),
    )
