"""Which ground actions a plan can use: backwards from the goals, then forwards from the initial state.

See robomend.planning.grounding for why nothing is lost.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence

from robomend.planning.grounding import GroundAction, Grounder, GroundProblem

MAX_REASON_DEPTH = 6


def ground(grounder: Grounder, goal: Iterable[int]) -> GroundProblem:
    """Return the relevant, reachable part of the problem; goals that nothing reaches are named."""
    wanted = frozenset(goal)
    actions, _ = _relevant(grounder, wanted, grounder.achievers)
    reached = _reachable(grounder, actions, wanted)
    unreachable = {number: _why(grounder, number, reached, actions) for number in sorted(wanted - reached)}
    wanted &= reached
    while True:
        actions = [action for action in actions if action.needs <= reached]
        achievers: dict[int, list[GroundAction]] = defaultdict(list)
        for action in actions:
            for number in action.effects:
                achievers[number].append(action)
        kept, changing = _relevant(grounder, wanted, achievers.__getitem__)
        if len(kept) == len(actions):
            break
        # Every fact that is still needed has all its achievers here, so what could be reached still can be.
        actions = kept
    both_signs = changing | {-number for number in changing}
    return GroundProblem(
        actions=tuple(
            GroundAction(
                action.name,
                action.parameters,
                action.cost,
                action.needs & changing,
                action.effects & both_signs,
            )
            for action in actions
        ),
        initial=frozenset(number for number in changing if grounder.holds_at_first(number)),
        goal=wanted & changing,
        unreachable=unreachable,
    )


def _relevant(
    grounder: Grounder, goal: frozenset[int], achievers: Callable[[int], Sequence[GroundAction]]
) -> tuple[list[GroundAction], frozenset[int]]:
    """Return the relevant actions, and the facts that matter and change."""
    needed: set[int] = set()
    destroyed: set[int] = set()
    changing: set[int] = set()
    actions: dict[int, GroundAction] = {}
    pending: list[int] = []

    def look(number: int) -> None:
        if number in changing or number not in needed:
            return
        if number in destroyed or not grounder.holds_at_first(number):
            changing.add(number)
            pending.append(number)

    needed |= goal
    for number in sorted(goal, key=abs):
        look(number)
    position = 0
    while position < len(pending):
        number = pending[position]
        position += 1
        for action in achievers(number):
            if id(action) in actions:
                continue
            actions[id(action)] = action
            needed |= action.needs
            destroyed.update(-effect for effect in action.effects)
            for other in action.needs:
                look(other)
            for effect in action.effects:
                look(-effect)
    return list(actions.values()), frozenset(changing)


def _reachable(grounder: Grounder, actions: Sequence[GroundAction], goal: frozenset[int]) -> frozenset[int]:
    """Return the facts that can be reached when nothing is ever destroyed."""
    waiting: dict[int, list[int]] = defaultdict(list)
    missing = [0] * len(actions)
    asked: set[int] = set(goal)
    pending: list[int] = []
    for index, action in enumerate(actions):
        missing[index] = len(action.needs)
        asked |= action.needs
        for number in action.needs:
            waiting[number].append(index)
        if not action.needs:
            pending.extend(action.effects)
    pending.extend(number for number in asked if grounder.holds_at_first(number))
    reached: set[int] = set()
    while pending:
        number = pending.pop()
        if number in reached:
            continue
        reached.add(number)
        for index in waiting.get(number, ()):
            missing[index] -= 1
            if not missing[index]:
                pending.extend(actions[index].effects)
    return frozenset(reached)


def _why(grounder: Grounder, goal: int, reached: frozenset[int], actions: Sequence[GroundAction]) -> str:
    """Return a sentence that names the goal's component and what is in the way."""
    words: list[str] = []
    number, seen = goal, {goal}
    for _ in range(MAX_REASON_DEPTH):
        achievers = [action for action in actions if number in action.effects]
        if not achievers:
            if number in grounder.refused:
                words.append(grounder.refused[number])
            elif number == goal:
                words.append(
                    f"no known action makes it {grounder.fact(number)[0]}{_what_it_lacks(grounder, goal)}"
                )
            else:
                words.append("no known action brings that about")
            break
        action = min(achievers, key=lambda one: (len(one.needs - reached), str(one)))
        blocking = sorted(action.needs - reached - seen, key=abs)
        if not blocking:
            words.append("the actions that would help wait for each other")
            break
        number = blocking[0]
        seen.add(number)
        words.append(f"{action} needs {grounder.literal(number)}")
    name = grounder.fact(goal)[1:]
    return f"{', '.join(name) or grounder.fact(goal)[0]}: {', and '.join(words)}"


def _what_it_lacks(grounder: Grounder, goal: int) -> str:
    """Return why the shipped actions do not apply to a component, in brackets; nothing where they might."""
    _, *names = grounder.fact(goal)
    for name in names:
        kind = grounder.problem.objects.get(name, "object")
        for wanted, fact, why in (
            ("hardware", "switchable", " (it has no power channel)"),
            ("node", "restartable", " (it is not restartable)"),
        ):
            if grounder.domain.is_a(kind, wanted) and (fact, name) not in grounder.problem.initial:
                return why
    return ""
