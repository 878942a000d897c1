"""What was tried, and how probable each diagnosis is after it: the memory that choosing rests on. Pure.

weight of a diagnosis   its posterior, or without priors one factor a component (small sets first) and
                        how well what works fits it (robomend.diagnosis.ranking); lowered for each
                        of its components that a repair made good without help: much when its effect was
                        seen (it runs again and still nothing: it was not that), little when it was not,
                        and by a half where a power cycle was the cure: a device that is broken is not
                        cured by one; what helped, and not for long, did not cure it either, and says as
                        much as a repair whose effect was not seen
interruption            power that was seen to go and come back by itself was a cycle of what hangs on it,
                        in vain for what is mute since: the connections of its drivers are dead
surely broken           a node that an earlier round of the repair knew to be broken, and did not cure: to
                        blame something else instead takes one fault more, at its odds
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from math import exp, log
from operator import or_

from robomend.diagnosis.result import Diagnosis
from robomend.model.components import ComponentModel
from robomend.planning.cures import CURES, Cure, carried, cycled
from robomend.planning.plan import Plan
from robomend_client.literals import Atom

S_TO_NS = 1_000_000_000

OURS_NS = 5 * S_TO_NS
"""So long before its first act or after its end, an attempt may have been seen."""

COMPONENT_ODDS = 0.01
"""P(AB) / P(¬AB) of a component without a prior."""

SEEN_FACTOR = 0.1
UNSEEN_FACTOR = 0.5
"""What a repair that did not help leaves of a diagnosis, where its effect was seen, and where it was not."""

AGAIN_FACTOR = 0.5
"""The same of one more repair of what was repaired in vain before: that says less and less."""

MEMORY_S = 3600.0
"""How long an attempt lowers its diagnosis."""

LEADING = 6
"""How many diagnoses are planned for."""


@dataclass(frozen=True, slots=True)
class Attempt:
    """The memory of one repair attempt."""

    bad: frozenset[str]  # the diagnosis that was repaired
    repaired: frozenset[str]  # every component that the steps done were to make good
    time_ns: int
    effect_seen: bool  # each action's effect was seen
    helped: bool  # the next diagnosis did not blame `bad`, whoever is credited with that
    actions: tuple[str, ...] = ()  # as text, for people
    cycled: frozenset[str] = frozenset()  # what was to be cured by a power cycle, which seldom is for sure
    began_ns: int = 0  # when it was needed; 0: when it ended
    by_itself: bool = False  # nothing blamed `bad` any more, and that was nothing the repair had done
    lasted: bool = True  # False: it helped, and soon the same was suspected again (quarantine.py)
    symptom_ns: int = 0  # when what it was for began to fail; 0: nobody knows
    down: tuple[tuple[str, int], ...] = ()  # nodes that did not run when it began, with since when
    sent_ns: tuple[int, ...] = ()  # when its actions were sent, the first one first


def attempt(
    diagnosis: Diagnosis,
    plan: Plan,
    *,
    done: Collection[int] | None,
    time_ns: int,
    effect_seen: bool,
    helped: bool,
    began_ns: int = 0,
    model: ComponentModel | None = None,
) -> Attempt:
    """Return the memory of a repair.

    Args:
        done: the indices of the steps that were carried out; None: all.
        model: says what hangs on a supply, and was cycled with it.
    """
    steps = tuple(step for step in plan.steps if done is None or step.index in done)
    carried_out = replace(plan, steps=steps)
    along = frozenset[str]() if model is None else carried(carried_out, model)
    return Attempt(
        frozenset(diagnosis.bad),
        repaired_by(carried_out) | along,
        time_ns,
        effect_seen,
        helped,
        tuple(map(str, steps)),
        cycled(carried_out) | along,
        began_ns,
    )


def interruptions(
    model: ComponentModel, back: Mapping[str, int], onsets: Mapping[Atom, int], tried: Sequence[Attempt]
) -> tuple[list[Attempt], frozenset[str]]:
    """Return what was seen to lose its power for a moment, as attempts: it was cycled, and that did not help;
    and the drivers whose connections that has cut.

    Args:
        back: device -> when its power was seen to come back.
        onsets: of what is not ok, its last good sample: what was well after that was not cycled in vain.
        tried: what was done; a power cycle of ours is among it.
    """
    found: list[Attempt] = []
    dropped: set[str] = set()
    for device, back_ns in sorted(back.items()):
        ours = (one for one in tried if device in one.repaired)
        if any((one.began_ns or one.time_ns) - OURS_NS <= back_ns <= one.time_ns + OURS_NS for one in ours):
            continue
        fed = {device, *(name for name in model.hardware if device in model.feeders(name))}
        mute = {
            name: node
            for name, node in model.nodes.items()
            if any(onsets.get(Atom("ok", (topic,)), back_ns + 1) <= back_ns for topic in node.publishes)
        }
        cycled = {name for node in mute.values() for name in node.drives if name in fed}
        if not cycled:
            continue
        names = frozenset(cycled | {device})
        found.append(Attempt(frozenset(), names, back_ns, effect_seen=True, helped=False, cycled=names))
        since = frozenset[str]().union(*(one.repaired for one in tried if one.time_ns > back_ns))
        dropped |= {
            name
            for name, node in mute.items()
            if not node.reconnects and not fed.isdisjoint(node.drives) and name not in since
        }
    return found, frozenset(dropped)


def repaired_by(plan: Plan) -> frozenset[str]:
    """Return the components that the plan makes good (again) and leaves good."""
    state: dict[str, bool] = {}
    for step in plan.steps:
        for effect in step.effects:
            if effect.atom.predicate == "good" and len(effect.atom.args) == 1:
                state[effect.atom.args[0]] = effect.positive
    return frozenset(name for name, good in state.items() if good)


def weights(
    diagnoses: Sequence[Diagnosis],
    tried: Iterable[Attempt] = (),
    *,
    fits: Sequence[float] | None = None,
    now_ns: int = 0,
) -> list[float]:
    """Return P(diagnosis) for each, attempts taken into account; they sum to 1.

    A minimal diagnosis blames nothing that what is observed now does not need. So each of its components that
    a repair made good must be bad all the same, whatever else it blames.

    Args:
        fits: how well OBS fits each, as far as the probabilities do not have it in them.
    """
    if diagnoses and all(diagnosis.probability is not None for diagnosis in diagnoses):
        raw = [diagnosis.probability or 0.0 for diagnosis in diagnoses]
    else:
        # Relative to the smallest, so that a hundred bad components do not underflow.
        least = min((len(diagnosis.bad) for diagnosis in diagnoses), default=0)
        raw = [COMPONENT_ODDS ** (len(diagnosis.bad) - least) for diagnosis in diagnoses]
    if fits is not None:
        raw = [odds * fit for odds, fit in zip(raw, fits, strict=True)]
    oldest = now_ns - int(MEMORY_S * S_TO_NS)
    failed = sorted((one for one in tried if not one.helped and one.time_ns >= oldest), key=_time)
    before = list(accumulate((one.repaired if one.effect_seen else frozenset() for one in failed), or_))
    again = [frozenset[str](), *before]
    blamed = [frozenset(diagnosis.bad) for diagnosis in diagnoses]
    doubts = [sum(_doubt(bad, *each) for each in zip(failed, again, strict=False)) for bad in blamed]
    least_doubt = max(doubts, default=0.0)  # so that a hundred components do not underflow
    raw = [odds * exp(doubt - least_doubt) for odds, doubt in zip(raw, doubts, strict=True)]
    total = sum(raw)
    return [value / total if total > 0 else 1 / len(raw) for value in raw]


def _time(one: Attempt) -> int:
    return one.time_ns


def _doubt(bad: Collection[str], failed: Attempt, before: Collection[str]) -> float:
    """Return the logarithm of what a repair that did not help leaves of a diagnosis.

    Args:
        before: what earlier repairs had made good in vain.
    """
    factor = SEEN_FACTOR if failed.effect_seen else UNSEEN_FACTOR
    again = failed.repaired.intersection(bad)
    if not again and bad == failed.bad:  # it could not be carried out
        return log(factor)
    doubt = 0.0
    for name in sorted(again):
        cure = CURES[Cure.POWER_CYCLE if name in failed.cycled else Cure.OTHER]
        left = AGAIN_FACTOR if name in before and name not in failed.cycled else factor
        doubt += log(left + (1 - cure) * (1 - left))
    return doubt


def unbroken_fits(
    diagnoses: Sequence[Collection[str]],
    surely_broken: Collection[str],
    priors: Mapping[str, float],
) -> list[float]:
    """Return how well each diagnosis fits what was surely broken a moment ago and was repaired without help,
    relative to the best.

    A process had ended, its successor runs, and its topic is silent: either the successor is no better, or
    something else broke besides.
    """

    def log_odds(name: str) -> float:
        prior = priors.get(name)
        return log(COMPONENT_ODDS if prior is None else prior / (1 - prior))

    logs = [sum(log_odds(name) for name in sorted(set(surely_broken).difference(bad))) for bad in diagnoses]
    best = max(logs, default=0.0)
    return [exp(one - best) for one in logs]  # so that a hundred components do not underflow


def leading(
    diagnoses: Sequence[Diagnosis],
    tried: Iterable[Attempt] = (),
    *,
    fits: Sequence[float] | None = None,
    switchable: Collection[str] = (),
    now_ns: int = 0,
) -> list[Diagnosis]:
    """Return the diagnoses worth planning for, the most probable first.

    Of equally probable ones those come first that blame fewer of `switchable`, whose repair cuts power.
    """
    found = weights(diagnoses, tried, fits=fits, now_ns=now_ns)
    cuts = [sum(name in switchable for name in diagnosis.bad) for diagnosis in diagnoses]
    order = sorted(range(len(diagnoses)), key=lambda index: (-round(found[index], 12), cuts[index]))
    return [diagnoses[index] for index in order[:LEADING] if diagnoses[index].bad]
