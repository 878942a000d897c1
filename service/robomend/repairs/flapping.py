"""Faults that come and go: what is well again each time before anything could be done about it.

    repair ends "became so by itself" ──► again, and again within a minute ──► a person is told, once
                                                                                 │
    the same suspects ──► no repair, unless they are blamed for STEADY_S on end ◄┘ for HELD_S

Nothing is restarted for it: whether that would help cannot be seen of a topic that comes back anyway. Of one
robot, in memory: after a restart of the service it is counted anew.
"""

from __future__ import annotations

from collections import deque

from robomend.planning.tried import DEFAULT_PATIENCE
from robomend.repairs.conclusions import BadSets

WITHIN_S = DEFAULT_PATIENCE.relapse_s
TIMES = DEFAULT_PATIENCE.relapses
"""So often within that time it is a fault by itself."""

HELD_S = DEFAULT_PATIENCE.backoff_s
"""For so long nothing is begun for the same suspects …"""

STEADY_S = 5.0
"""… unless they are blamed for so long on end."""


class Flapping:
    """Times are seconds of a clock that does not jump."""

    def __init__(self) -> None:
        self._ended: deque[tuple[float, frozenset[str]]] = deque(maxlen=TIMES)
        self._held: frozenset[str] = frozenset()  # the suspects for which nothing is begun
        self._until_s = 0.0

    def well_by_itself(self, blamed: BadSets | None, now_s: float) -> str | None:
        """A repair has ended for which nothing was done; return what to tell a person, if it is time to."""
        suspects = frozenset(name for bad in blamed or () for name in bad)
        self._ended.append((now_s, suspects))
        first_s = self._ended[0][0]
        if len(self._ended) < TIMES or now_s - first_s > WITHIN_S:
            return None
        self._held = frozenset().union(*(names for _, names in self._ended))
        self._until_s = now_s + HELD_S
        self._ended.clear()
        names = ", ".join(sorted(self._held))
        return (
            f"it comes and goes: {TIMES} times within {max(1.0, now_s - first_s):.0f} s something was not as "
            f"it should be and well again before anything was done; suspects: {names or 'unknown'}. Nothing "
            f"is begun for them in the next {HELD_S:g} s unless it lasts {STEADY_S:g} s; look at the robot, "
            "or have its observers judge more slowly"
        )

    def hold_s(self, blamed: BadSets, now_s: float) -> float:
        """Return how long these must have been blamed on end before something is begun."""
        held = now_s < self._until_s and all(self._held.intersection(bad) for bad in blamed)
        return STEADY_S if held else 0.0
