"""The cheapest further observables that tell faults apart: implicit hitting sets, by our own engine.

Observing more never hides what could be told before. So for a pair of faults (or a fault and health) the sets
of further observables that do not tell it apart are closed downwards, and each maximal one is a conflict:
whatever tells the pair apart observes something outside it.

    cheapest set U that hits the known conflicts ──► all pairs told apart?  yes ──► the answer
              ▲                                              │ no, not this pair
              └── the rest of U, grown as long as the pair ◄─┘
                  stays together, is a new conflict

What cannot be told apart by all observables together is left out, and said.

Source: E. Moreno-Centeno, R. Karp. The implicit hitting set approach. OR 61(2), 2013.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from robomend.diagnosis.guided import CheapestHittingSets
from robomend.diagnosis.isolability.comparing import Comparison, Fault
from robomend.diagnosis.masks import bits
from robomend.diagnosis.oracle import Deadline

COST_SCALE = 1_000_000
"""Costs are whole microseconds."""


@dataclass(frozen=True, slots=True)
class Separation:
    """A fault that is to be told from a rival, or, without one, from health."""

    fault: Fault
    rival: Fault | None = None

    def reached(self, by: Comparison) -> bool:
        """Whether a comparison does that."""
        return by.shows(self.fault) if self.rival is None else by.told(self.fault, self.rival)


@dataclass(frozen=True, slots=True)
class Cheapest:
    """The cheapest further observables, as variables; none if no goal can be reached."""

    variables: tuple[int, ...]
    reached: tuple[Separation, ...]
    beyond: tuple[Separation, ...]  # no observable of the model helps


def cheapest(
    now: Comparison, goals: Sequence[Separation], cost_s: Callable[[int], float], clock: Deadline
) -> Cheapest:
    """Return a cheapest set of further observables that reaches every goal that can be reached.

    Raises:
        OutOfTime: the clock ran out.
    """
    faults = {fault for goal in goals for fault in (goal.fault, goal.rival) if fault is not None}
    relevant: set[int] = set()
    for fault in faults:
        relevant |= now.relevant(fault)
    candidates = sorted(relevant)
    tried = _Tried(now, candidates)
    try:
        everything = (1 << len(candidates)) - 1
        within = tuple(goal for goal in goals if tried.reached(goal, everything))
        beyond = tuple(goal for goal in goals if goal not in within)
        if not within:
            return Cheapest((), (), beyond)
        sets = CheapestHittingSets([max(1, round(cost_s(v) * COST_SCALE)) for v in candidates], clock)
        try:
            while True:
                chosen = sets.next()
                assert chosen is not None, "observing everything reaches these goals"
                missed = next((goal for goal in within if not tried.reached(goal, chosen)), None)
                if missed is None:
                    return Cheapest(tuple(candidates[bit] for bit in bits(chosen)), within, beyond)
                sets.hit(everything & ~_grown(tried, missed, chosen, bits(everything & ~chosen)))
        finally:
            sets.close()
    finally:
        tried.close()


def _grown(tried: _Tried, goal: Separation, chosen: int, others: Sequence[int]) -> int:
    """Return a maximal superset of `chosen` by `others` that does not reach the goal either: all of them at
    once, or one half and then the other.
    """
    more = chosen
    for bit in others:
        more |= 1 << bit
    if more == chosen or not tried.reached(goal, more):
        return more
    if len(others) == 1:
        return chosen
    middle = len(others) // 2
    return _grown(tried, goal, _grown(tried, goal, chosen, others[:middle]), others[middle:])


class _Tried:
    """Comparisons with further observables; the one asked last is kept, as goals are asked in a row."""

    def __init__(self, now: Comparison, candidates: Sequence[int]) -> None:
        self._now = now
        self._candidates = candidates
        self._mask = 0
        self._with: Comparison | None = None

    def reached(self, goal: Separation, mask: int) -> bool:
        if self._with is None or mask != self._mask:
            self.close()
            self._mask = mask
            self._with = self._now.observing(self._candidates[bit] for bit in bits(mask))
        return goal.reached(self._with)

    def close(self) -> None:
        if self._with is not None:
            self._with.close()
            self._with = None
