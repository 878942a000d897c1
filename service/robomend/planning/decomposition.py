"""Split a ground problem into parts that can be planned one by one, without losing the cheapest plan.

    actions that write a common fact                 ──► one part
    an action reads a fact that others write
        the fact is a goal                           ──► the writers' part is planned first
        it is not                                    ──► one part

A fact that is a goal holds at the end of its part's plan, and the readers' part never writes it. So the
plans one after the other are a plan. It is a cheapest one if each is: restricted to one part's actions, any
plan of the whole is a plan of that part, as nobody else writes what it reads, except goal facts, and those
are at best true all along. Parts that wait for each other in a circle are one part.

A robot's parts are small (a device with its drivers), so a planner sees ten actions where the robot has
thousands, and parts that are equal but for names are planned once (`Part` holds no names).

Source: C. Knoblock. Automatically generating abstractions for planning. AIJ 68, 1994 (ordered decomposition
over the causal graph); M. Helmert. The Fast Downward planning system. JAIR 26, 2006 (causal graphs).
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

from robomend.model.loops import strong_components
from robomend.planning.grounding import GroundAction, GroundProblem


@dataclass(frozen=True, slots=True)
class PartAction:
    """An action over the facts 0 … n-1 of its part."""

    cost: float
    needs: frozenset[int]
    adds: frozenset[int]
    deletes: frozenset[int]


@dataclass(frozen=True, slots=True)
class Part:
    """A STRIPS problem without names: two robots' equal parts are equal values."""

    facts: int
    actions: tuple[PartAction, ...]
    initial: frozenset[int]
    goal: frozenset[int]


@dataclass(frozen=True)
class NamedPart:
    """A part with the actions and goals that its numbers stand for."""

    part: Part
    actions: tuple[GroundAction, ...]
    goals: tuple[int, ...]  # signed facts of the ground problem


def split(problem: GroundProblem) -> list[NamedPart]:
    """Return the parts that have something to do, in an order in which they can be carried out."""
    group = _UnionFind(len(problem.actions))
    writers: dict[int, list[int]] = defaultdict(list)
    for index, action in enumerate(problem.actions):
        for number in action.effects:
            writers[abs(number)].append(index)
    for indices in writers.values():
        for index in indices[1:]:
            group.join(indices[0], index)
    for index, action in enumerate(problem.actions):
        for number in action.needs:
            if number not in problem.goal:
                for writer in writers.get(abs(number), ()):
                    group.join(index, writer)
    before: dict[str, set[str]] = {}
    for index, action in enumerate(problem.actions):
        reads = before.setdefault(str(group.of(index)), set())
        for number in action.needs:
            for writer in writers.get(abs(number), ())[:1]:
                reads.add(str(group.of(writer)))
    # A part's successors here are the parts that it waits for, so they get the lower numbers.
    order = strong_components({name: sorted(others - {name}) for name, others in before.items()})
    members: dict[int, list[int]] = defaultdict(list)
    for index in range(len(problem.actions)):
        members[order[str(group.of(index))]].append(index)
    parts = [_part(problem, [problem.actions[i] for i in members[number]]) for number in sorted(members)]
    return [part for part in parts if not part.part.goal <= part.part.initial]


def _part(problem: GroundProblem, actions: list[GroundAction]) -> NamedPart:
    written = {abs(number) for action in actions for number in action.effects}
    numbers: dict[int, int] = {}
    for action in actions:
        # Both signs of an atom are facts of their own here, if anybody reads them.
        for number in (*sorted(action.needs), *sorted(action.effects), *sorted(-n for n in action.effects)):
            if abs(number) in written:
                numbers.setdefault(number, len(numbers))
    read = {number for action in actions for number in action.needs} | problem.goal
    kept = {number: index for index, number in enumerate(one for one in numbers if one in read)}
    goals = tuple(number for number in kept if number in problem.goal)
    return NamedPart(
        Part(
            facts=len(kept),
            actions=tuple(
                PartAction(
                    action.cost,
                    frozenset(kept[number] for number in action.needs if number in kept),
                    frozenset(kept[number] for number in action.effects if number in kept),
                    frozenset(kept[-number] for number in action.effects if -number in kept),
                )
                for action in actions
            ),
            initial=frozenset(index for number, index in kept.items() if number in problem.initial),
            goal=frozenset(kept[number] for number in goals),
        ),
        tuple(actions),
        goals,
    )


class _UnionFind:
    def __init__(self, size: int) -> None:
        self._parent = list(range(size))

    def of(self, index: int) -> int:
        parent = self._parent
        while parent[index] != index:
            parent[index] = parent[parent[index]]
            index = parent[index]
        return index

    def join(self, one: int, other: int) -> None:
        self._parent[self.of(other)] = self.of(one)
