"""From a plan in a row to a partial order: what does not interfere may run side by side.

Of two actions the earlier stays first if one of them destroys what the other needs or achieves, or if the
earlier achieves what the later needs. Any two others can swap, and swapping neighbours that do not
interfere changes neither what holds before any action nor the end; every order that keeps these pairs can
be reached by such swaps, so every one is a plan (the partial order of a Mazurkiewicz trace).

Within that order what is stopped or switched off is so as late as may be: nothing stays away while its
return waits for something else, which may fail.

Source: C. Bäckström. Computational aspects of reordering plans. JAIR 9, 1998 (deordering).
"""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Callable, Sequence

from robomend.planning.grounding import GroundAction


def partial_order(plan: Sequence[GroundAction]) -> list[tuple[int, ...]]:
    """Return for each action the positions of those right before it (transitively reduced)."""
    achieved: dict[int, list[int]] = defaultdict(list)  # fact -> the actions so far that achieve it
    needed: dict[int, list[int]] = defaultdict(list)
    before: list[int] = []  # bit sets, transitively closed
    direct: list[tuple[int, ...]] = []
    for position, action in enumerate(plan):
        earlier: set[int] = set()
        for number in action.needs:
            earlier.update(achieved[number])
            earlier.update(achieved[-number])
        for number in action.effects:
            earlier.update(needed[-number])
            earlier.update(achieved[-number])
        covered = 0
        kept: list[int] = []
        for other in sorted(earlier, reverse=True):
            if not covered >> other & 1:
                kept.append(other)
                covered |= before[other] | 1 << other
        before.append(covered)
        direct.append(tuple(sorted(kept)))
        for number in action.needs:
            needed[number].append(position)
        for number in action.effects:
            achieved[number].append(position)
    return direct


def late(plan: Sequence[GroundAction], after: Sequence[tuple[int, ...]]) -> list[tuple[int, ...]]:
    """Return the order with each stop and shutdown put off until all is done that its return waits for."""
    before = [set(one) for one in after]
    for position, action in enumerate(plan):
        back = next((p for p in range(position + 1, len(plan)) if _brings_back(plan[p], action)), None)
        if back is None or position not in _ancestors(before, back):
            continue
        for other in sorted(before[back] - {position}):
            if position not in _ancestors(before, other):
                before[position].add(other)
    for position, direct in enumerate(before):
        implied = set().union(*(_ancestors(before, other) for other in direct))
        before[position] = direct - implied
    return [tuple(sorted(one)) for one in before]


def _brings_back(later: GroundAction, earlier: GroundAction) -> bool:
    """Return whether an action gives a component back what another has taken from it."""
    return (earlier.name, later.name) in PAIRED and earlier.parameters == later.parameters


PAIRED = {("stop_node", "start_node"), ("shutdown", "power_up")}


def _ancestors(before: Sequence[set[int]], position: int) -> set[int]:
    found: set[int] = set()
    pending = list(before[position])
    while pending:
        one = pending.pop()
        if one not in found:
            found.add(one)
            pending += before[one]
    return found


def layered(after: Sequence[tuple[int, ...]], rank: Callable[[int], tuple[int, ...]]) -> list[int]:
    """Return the positions in an order that keeps `after` and puts low ranks first where it is free to."""
    waiting = [len(one) for one in after]
    followers: dict[int, list[int]] = defaultdict(list)
    for position, one in enumerate(after):
        for other in one:
            followers[other].append(position)
    ready = [(rank(position), position) for position, count in enumerate(waiting) if not count]
    heapq.heapify(ready)
    order: list[int] = []
    while ready:
        _, position = heapq.heappop(ready)
        order.append(position)
        for follower in followers[position]:
            waiting[follower] -= 1
            if not waiting[follower]:
                heapq.heappush(ready, (rank(follower), follower))
    return order
