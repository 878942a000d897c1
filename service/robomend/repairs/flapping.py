"""Faults that come and go: what is well again each time before anything could be done about it, and what is
broken again soon after each repair.

    repair ends "became so by itself" ──► again, and again within a minute ──► a person is told, once
                                                                                 │
    the same suspects ──► no repair, unless they are blamed for STEADY_S on end ◄┘ for HELD_S

    a repair helped, and did not last ──► again, and again ──► a person is told, once; the same suspects: no
                                                               repair until their quarantine ends

Nothing is restarted for the first: whether that would help cannot be seen of a topic that comes back anyway.
It is in memory, of one robot: after a restart of the service it is counted anew. The second rests on what was
tried (robomend.planning.quarantine), which is on disk.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Sequence
from dataclasses import replace
from datetime import UTC, datetime

from robomend.diagnosis.result import DiagnosisResult
from robomend.model.components import ComponentModel
from robomend.planning.advice import Situation
from robomend.planning.choice import Choice, makes_good
from robomend.planning.policy import NODE_ACTIONS
from robomend.planning.quarantine import BACKOFF_S, Patience, came_back, downed, undoing
from robomend.planning.tried import S_TO_NS, Attempt
from robomend.repairs.conclusions import BadSets
from robomend.repairs.remembering import Remembered
from robomend_client.counts import counted, listed

WITHIN_S = 60.0
TIMES = 6
"""So often within that time it is a fault by itself."""

HELD_S = BACKOFF_S
"""For so long nothing is begun for the same suspects …"""

STEADY_S = 5.0
"""… unless they are blamed for so long on end."""


class Flapping:
    """Times are seconds of a clock that does not jump."""

    def __init__(self) -> None:
        self._ended: deque[tuple[float, frozenset[str]]] = deque(maxlen=TIMES)
        self._held: frozenset[str] = frozenset()  # the suspects for which nothing is begun
        self._until_s = 0.0
        self._aside: frozenset[str] = frozenset()  # those whose repairs did not last
        self._aside_until_s = 0.0

    def well_by_itself(self, blamed: BadSets | None, now_s: float) -> str | None:
        """A repair has ended for which nothing was done; return what to tell a person, if it is time to."""
        suspects = _names(blamed)
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

    def came_back(self, blamed: BadSets, until_s: float) -> None:
        """A person was told that repairs of these do not last: none is begun until then."""
        self._aside, self._aside_until_s = _names(blamed), until_s

    def released(self) -> None:
        """A person changed something: what was repaired in vain may last now."""
        self._aside_until_s = 0.0

    def wait_s(self, blamed: BadSets, now_s: float, for_s: float) -> float:
        """Return how long to wait before something is begun for these, which were blamed for `for_s`."""
        if now_s < self._aside_until_s and all(self._aside.intersection(bad) for bad in blamed):
            return self._aside_until_s - now_s
        held = now_s < self._until_s and all(self._held.intersection(bad) for bad in blamed)
        return max(0.0, STEADY_S - for_s) if held else 0.0


def lasting(choice: Choice, result: DiagnosisResult, memory: Remembered, situation: Situation) -> Choice:
    """Return the choice, or that nothing is done, where repairs of what is suspected help and do not last.

    One less is enough where only power is left to be cut. Beside another fault, which did not come back, that
    one is repaired.
    """
    relapses, patience, now_ns = memory.relapses, situation.patience, situation.now_ns
    suspected = dict.fromkeys(name for one in result.diagnoses for name in one.bad)
    enough = patience.relapses if choice.plan is not None else patience.relapses - 1
    if not relapses or len(relapses) < enough:
        return choice
    lower = replace(patience, relapses=min(patience.relapses, len(relapses)))
    back = came_back(relapses, suspected, now_ns=now_ns, patience=lower)
    if not back:
        return choice
    new = {name: entry for name, entry in back.items() if name not in memory.aside}
    if choice.plan is not None and all(len(one.bad) > 1 for one in result.diagnoses):
        return replace(choice, came_back=new)
    reason = does_not_last(relapses, suspected, max(one.until_ns for one in back.values()), now_ns)
    nothing = replace(choice, diagnosis=None, plan=None, probe=None, reason=reason)
    return replace(nothing, unlasting=True, came_back=new)


def not_undone(
    choice: Choice,
    memory: Remembered,
    symptom_ns: int,
    down: tuple[tuple[str, int], ...],
    parts: ComponentModel,
    patience: Patience,
) -> Choice:
    """Return the choice, or that nothing is done, where it would begin a circle of repairs anew of which each
    breaks what the next one mends, or start nodes that have gone down together after each start.

    Args:
        symptom_ns: when what the choice is for began to fail.
        down: the nodes that do not run, each with since when.
    """
    if choice.plan is None or choice.diagnosis is None:
        return choice
    cures = tuple(str(step) for step in choice.plan.steps if any(map(makes_good, step.effects)))
    bad = frozenset(choice.diagnosis.bad)
    begun = {"actions": cures, "symptom_ns": symptom_ns, "down": down}
    again = Attempt(bad, frozenset(), 0, effect_seen=False, helped=False, **begun)  # type: ignore[arg-type]  # fields by name
    only_nodes = all(step.name in NODE_ACTIONS for step in choice.plan.steps)
    if row := undoing(memory.all, again, parts, patience=patience):
        names = [" and ".join(sorted(one.bad)) for one in row]
        pairs = zip(row, names, [*names[1:], names[0]], strict=True)
        breaks = [f"{_doing(one)} {name} breaks {other}" for one, name, other in pairs]
        told = f"{breaks[0]}, and the other way round" if len(row) == 2 else ", ".join(breaks)
        look = "none of it is done again; look at what they share, as a bus, a port or a manager"
    elif only_nodes and (group := downed(memory.all, again, patience=patience)):
        told = f"{listed(sorted(group))} go down again together soon after each start"
        look = "something that the model does not know stops them, as a lifecycle manager: start them by that"
    else:
        return choice
    reason = f"{told}; {look}"
    return replace(choice, diagnosis=None, plan=None, probe=None, reason=reason, beyond=told)


def _doing(done: Attempt) -> str:
    """Return what was done, in one word."""
    names = {action.partition("(")[0] for action in done.actions}
    if not names <= NODE_ACTIONS:
        return "the repair of"
    return "restarting" if "stop_node" in names else "starting"


def does_not_last(relapses: Sequence[Attempt], suspected: Iterable[str], until_ns: int, now_ns: int) -> str:
    """Return what to tell a person of repairs that helped, and soon after each it was broken again."""
    begun = [*(one.began_ns or one.time_ns for one in relapses[1:]), now_ns]
    lasted_s = max((then - one.time_ns) / S_TO_NS for one, then in zip(relapses, begun, strict=True))
    times = Counter(" and ".join(sorted(one.bad)) for one in relapses)
    repaired = ", ".join(f"{names} ({counted(count, 'time')})" for names, count in times.items())
    helped = "helped" if any(not one.by_itself for one in relapses) else "ended well, by itself"
    until = datetime.fromtimestamp(until_ns / S_TO_NS, UTC).strftime("%H:%M:%S")
    return (
        f"it comes and goes: {counted(len(relapses), 'repair')} in a row {helped}, and each time it was "
        f"broken again within {max(1.0, lasted_s):.0f} s; repaired: {repaired}; "
        f"suspects: {', '.join(suspected)}. "
        f"Nothing is begun for them before {until} UTC, or before somebody releases what is in quarantine; "
        "look at the robot, or have its observers judge more slowly"
    )


def _names(blamed: BadSets | None) -> frozenset[str]:
    return frozenset(name for bad in blamed or () for name in bad)
