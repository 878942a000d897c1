"""Quarantine: components whose repairs keep failing, or never last, are left alone; the time doubles.

    did not help   three in a row ──► left alone
    did not last   it helped, and within half a minute the same is suspected again
                   three in a row ──► left alone
                   two in a row   ──► power is not cut for it any more (choice.py)

That a repair did not last is known when its components are suspected again, and not only when they were
repaired once more. Whose turn it was does not matter: that a driver was restarted, and then its device's
power was cycled, are two repairs of what came back both times.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

from robomend.model.components import ComponentModel
from robomend.planning.influence import reaches
from robomend.planning.tried import S_TO_NS, Attempt

FAILURES = 3
"""In a row, until a component is left alone."""

BACKOFF_S = 300.0
MAX_BACKOFF_S = 86_400.0
"""The first quarantine, doubled by each further failure, up to a day."""


@dataclass(frozen=True, slots=True)
class Patience:
    """With repairs that help, and not for long."""

    relapses: int = 3  # in a row until quarantine; one less where power is cut
    relapse_s: float = 30.0  # what needs a repair again so soon was not mended by the last one


DEFAULT_PATIENCE = Patience()


@dataclass(frozen=True, slots=True)
class Quarantined:
    """Why a component is left alone, and until when."""

    failures: int
    until_ns: int
    reason: str


def quarantined(tried: Iterable[Attempt], *, now_ns: int) -> dict[str, Quarantined]:
    """Return the components to leave alone now as their last repairs all failed, with doubling back-off."""
    failures: dict[str, int] = {}
    last_ns: dict[str, int] = {}
    for one in sorted(tried, key=lambda one: one.time_ns):
        for name in one.bad:
            failures[name] = 0 if one.helped else failures.get(name, 0) + 1
            last_ns[name] = one.time_ns
    found: dict[str, Quarantined] = {}
    for name, count in failures.items():
        until_ns = last_ns[name] + _backoff_ns(count - FAILURES)
        if now_ns < until_ns:
            why = f"{name} was repaired {count} times in a row and it did not help"
            found[name] = Quarantined(count, until_ns, why)
    return found


def relapses(
    tried: Iterable[Attempt],
    suspected: Collection[str],
    *,
    now_ns: int,
    patience: Patience = DEFAULT_PATIENCE,
) -> tuple[Attempt, ...]:
    """Return the repairs in a row that helped what is suspected now, and did not last; the oldest first.

    Nothing where the last of them lasted for `relapse_s`. What is begun as soon after a quarantine ended has
    waited for that, and did not last either.
    """
    row: list[Attempt] = []
    soon_ns = int(patience.relapse_s * S_TO_NS)
    lasts = False  # nothing is known to have been wrong since the last one of the row
    for one in sorted(tried, key=lambda one: one.time_ns):
        if one.bad.isdisjoint(suspected):
            continue
        if lasts:
            lasted_ns = (one.began_ns or one.time_ns) - row[-1].time_ns
            waited_ns = _backoff_ns(len(row) - patience.relapses)
            if lasted_ns > soon_ns and not waited_ns <= lasted_ns <= waited_ns + soon_ns:
                row = []
            lasts = False
        if one.helped:
            row.append(one)
            lasts = True
    if lasts and now_ns - row[-1].time_ns > soon_ns:
        return ()
    return tuple(row)


BEFORE_NS = S_TO_NS
"""The last good sample of what an act broke may be so much older than the act."""


AT_ONCE_NS = S_TO_NS
"""What fails so soon after an action was sent, was broken by it: two faults seldom coincide so closely, and
not one after the other …"""

ALIKE_NS = S_TO_NS
"""… or twice equally late, to so much, which is no coincidence either."""


def undoing(
    tried: Iterable[Attempt],
    again: Attempt,
    model: ComponentModel,
    *,
    patience: Patience = DEFAULT_PATIENCE,
) -> tuple[Attempt, ...]:
    """Return the repairs in a row that would begin anew with this one, the oldest first: each brought back
    what it was for, and soon after its acts that failed which the next one was for, in the end what the first
    was for. Nothing where this would do something else, or follows from nothing that was done; nor where
    some of what a repair was for fails again, too: that did not last, and nothing else broke by it. Nor where
    it may be faults of their own that come in turn: each failed at once, or the whole row twice alike, and
    one more of them than that where the model knows no way from one to the next.
    """
    row: list[Attempt] = []
    later_ns: list[int] = []  # how long after an action of each the next one's fault began
    once = 0  # how many repairs it takes until they begin anew
    soon_ns, broken = int(patience.relapse_s * S_TO_NS), again
    for one in sorted(tried, key=lambda one: -one.time_ns):
        by_it = one.began_ns - BEFORE_NS <= broken.symptom_ns <= one.time_ns + soon_ns
        if not (one.helped and by_it and one.bad.isdisjoint(broken.bad)):
            break
        if once and one.bad != row[len(row) - once].bad:
            break
        row.append(one)
        before = (sent for sent in one.sent_ns if sent - BEFORE_NS <= broken.symptom_ns)
        later_ns.append(broken.symptom_ns - max(before, default=one.began_ns))
        if not once and one.bad == again.bad and set(again.actions) <= set(one.actions):
            once = len(row)
        broken = one
    circle = row[:once]
    hit = zip(circle, [again, *circle], strict=False)
    known = all(reaches(model, one.bad | one.repaired, other.bad) for one, other in hit)
    links = once if known else once + 1
    at_once = len(later_ns) >= links and max(later_ns[:links], default=0) <= AT_ONCE_NS
    apart_ns = [abs(a - b) for a, b in zip(later_ns, later_ns[once:], strict=False)][:links]
    alike = len(apart_ns) == links and max(apart_ns, default=0) <= ALIKE_NS
    return tuple(reversed(circle)) if at_once or alike else ()


def downed(
    tried: Iterable[Attempt], again: Attempt, *, patience: Patience = DEFAULT_PATIENCE
) -> frozenset[str]:
    """Return the nodes that go down together soon after each start, as a manager of theirs does it: several
    of them, after each of the last two repairs. Nothing where these do not, or are not to be started now.
    """
    groups: list[frozenset[str]] = []
    soon_ns, next_one = int(patience.relapse_s * S_TO_NS), again
    for one in sorted(tried, key=lambda one: -one.time_ns)[:2]:
        ours = {name for name, _ in next_one.down if _only_stopped(name, one.actions)}
        since_ns, until_ns = one.began_ns - BEFORE_NS, one.time_ns + soon_ns
        groups.append(
            frozenset(name for name, at_ns in next_one.down if since_ns <= at_ns <= until_ns) - ours
        )
        next_one = one
    if len(groups) < 2 or min(map(len, groups)) < 2:
        return frozenset()
    together = groups[0] | groups[1]
    return together if groups[0] & groups[1] & again.bad else frozenset()


def _only_stopped(name: str, actions: Collection[str]) -> bool:
    return f"stop_node({name})" in actions and f"start_node({name})" not in actions


def unlasting(tried: Iterable[Attempt], relapsed: Collection[Attempt]) -> tuple[Attempt, ...]:
    """Return the attempts, those that did not last as what they were: no cure."""
    again = set(relapsed)
    return tuple(
        replace(one, helped=False, effect_seen=False, lasted=False) if one in again else one for one in tried
    )


def came_back(
    relapsed: Sequence[Attempt],
    suspected: Collection[str],
    *,
    now_ns: int,
    patience: Patience = DEFAULT_PATIENCE,
) -> dict[str, Quarantined]:
    """Return the suspects to leave alone now as their repairs did not last, with doubling back-off.

    Args:
        relapsed: what `relapses` found.
    """
    times = len(relapsed)
    if times < max(1, patience.relapses):
        return {}
    until_ns = relapsed[-1].time_ns + _backoff_ns(times - patience.relapses)
    if now_ns >= until_ns:
        return {}
    names = frozenset[str]().union(*(one.bad for one in relapsed)).intersection(suspected)
    why = f"{times} repairs in a row helped, and soon it came back"
    return {name: Quarantined(times, until_ns, f"{name}: {why}") for name in sorted(names)}


def _backoff_ns(beyond: int) -> int:
    """Return how long to leave a component alone after so many repairs beyond those that are too many."""
    if beyond < 0:
        return 0
    # 2**63 s is longer than anybody waits; the exponent is bounded so that the power is too.
    return int(min(MAX_BACKOFF_S, BACKOFF_S * 2.0 ** min(beyond, 63)) * S_TO_NS)
