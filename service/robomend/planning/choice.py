"""Which repair to do next: pure, from diagnoses, their plans, what was tried, and what could be looked at.

The paper repairs the first diagnosis. Here each leading diagnosis is planned for, and the order is that of
decision-theoretic troubleshooting: repair, look, repair the next. With probability p(i) that repair i helps
and cost c(i), the expected cost Σ c(i) · P(none before i helped) is least in order of p(i) / c(i).

    weight of a diagnosis   how probable it is, what was tried taken into account: tried.py
    p(plan)                 weight of all diagnoses whose components the plan repairs, each times how probably
                            it then cures them (cures.py): a power cycle that restarts the driver helps
                            against a device that hangs and against a bad driver; lowered for a plan that
                            was carried out before, with its effects seen, and did not help
    common part             components that every leading diagnosis blames are repaired first, by
                            themselves, if what is saved when the first full repair is wrong exceeds the
                            cost of one more look
    worth                   only what costs less in the mean than to ask a person at once is done, be it a
                            restart or a cut of power; what helps every other time is done in any case
    power                   is not cut on a tie that a cheaper act would break: while another diagnosis, as
                            probable, can be repaired with less of it and was not tried, that comes first;
                            nor for what soon came back after each of the last two repairs (quarantine.py).
                            A cut that darkens what works costs as much more as to cycle that, and whatever
                            is worth doing and darkens less comes first
    probe                   if looking first makes the expected cost, the look included, smaller
    quarantine              a component whose repairs keep failing is left alone for a time: quarantine.py

So {jaguar} and {jaguar_node}, which the six clause schemes leave tied once the power is back and odometry is
still silent, are told apart: the device was tried, its effect was seen, so the driver is restarted, and power
is never cycled for ever.

Source: D. Heckerman, J. Breese, K. Rommelse. Decision-theoretic troubleshooting. CACM 38(3), 1995.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import mul

from robomend.diagnosis.result import Diagnosis
from robomend.planning.cures import Rates, cured, cycled, power_cuts, rates_in
from robomend.planning.plan import Outcome, Plan
from robomend.planning.quarantine import DEFAULT_PATIENCE, Patience, Quarantined
from robomend.planning.tried import (
    AGAIN_FACTOR,
    MEMORY_S,
    S_TO_NS,
    SEEN_FACTOR,
    Attempt,
    repaired_by,
    weights,
)
from robomend_client.counts import counted
from robomend_client.literals import Atom, Literal

# --- costs, in the unit of action costs, about seconds

LOOK_COST = 2.0
"""Of one more round of repair and diagnosis."""

PERSON_COST = 300.0
"""When every repair failed and somebody must come."""

ASK_COST = 30.0
"""Of a person's yes to a plan, where one is asked for."""

DARK_COST = 25.0
"""Of a device that works and loses its power: as much as to cycle it."""


@dataclass(frozen=True, slots=True)
class Look:
    """A probe as choosing sees it; see robomend.diagnosis.probes for where they come from."""

    atom: Atom
    cost: float  # in the unit of action costs, about seconds
    predicted: tuple[bool | None, ...]  # what each candidate's diagnosis predicts, in order; None: nothing


@dataclass(frozen=True, slots=True)
class Candidate:
    """A diagnosis and its plan."""

    diagnosis: Diagnosis
    plan: Plan
    works: frozenset[str] = frozenset()  # what it blames and of which something is seen to work
    carried: frozenset[str] = frozenset()  # what loses its power with what the plan cycles, and has it again
    darkens: frozenset[str] = frozenset()  # what works, and loses its power by the plan
    remedy: float = 1.0  # P(to act on it is a remedy for such symptoms, if it is what is wrong)
    elsewhere: str = ""  # what is probably wrong instead, by its symptoms, and where to look
    asks: bool = False  # the policy has a person say yes to the plan
    yes: str = ""  # why a person has to, whatever the policy says
    rates: Rates = field(default_factory=dict)  # how probably acts cure, where that is given or learned


@dataclass(frozen=True, slots=True)
class Alternative:
    """A candidate as it was weighed."""

    diagnosis: Diagnosis
    plan: Plan
    weight: float  # P(this diagnosis), what was tried taken into account; all weights sum to 1
    helps: float  # P(the plan helps)
    score: float  # helps per cost
    failures: int  # times that this was repaired, alone or with something else, and not cured
    reason: str
    spared: bool = False  # it is not done: it is not worth it, or it would cut power
    darkens: frozenset[str] = frozenset()  # what works, and loses its power by the plan
    yes: str = ""  # why a person has to say yes to it, whatever the policy says


@dataclass(frozen=True, slots=True)
class Choice:
    """What to do next: a plan, or a probe first, or nothing, with the reason in words."""

    diagnosis: Diagnosis | None
    plan: Plan | None
    probe: Look | None
    alternatives: tuple[Alternative, ...]  # best first; the chosen one included
    expected_cost: float  # of repairing in this order until it helps
    reason: str
    certain: frozenset[str] = frozenset()  # what every diagnosis blames
    beyond: str = ""  # what is probably wrong and no act mends, as a sentence: the reason begins with it
    yes: str = ""  # why a person has to say yes to the plan, whatever the policy says
    unlasting: bool = False  # nothing is done, as repairs of what is suspected do not last
    came_back: Mapping[str, Quarantined] = field(default_factory=dict)  # left alone for that from now on


def common_part(diagnoses: Sequence[Diagnosis]) -> tuple[str, ...]:
    """Return the components that every diagnosis blames, if each blames more; else nothing."""
    if len(diagnoses) < 2:
        return ()
    shared = frozenset.intersection(*(frozenset(diagnosis.bad) for diagnosis in diagnoses))
    if not shared or any(len(diagnosis.bad) == len(shared) for diagnosis in diagnoses):
        return ()
    return tuple(name for name in diagnoses[0].bad if name in shared)


def choose(
    candidates: Sequence[Candidate],
    tried: Sequence[Attempt] = (),
    looks: Sequence[Look] = (),
    *,
    common: Candidate | None = None,
    fits: Sequence[float] | None = None,
    now_ns: int = 0,
    patience: Patience = DEFAULT_PATIENCE,
    relapses: int = 0,
) -> Choice:
    """Return what to do next.

    Args:
        candidates: the leading diagnoses with their plans.
        tried: earlier attempts, in any order.
        looks: probes that somebody can make now.
        common: the plan for `common_part`, if there is one.
        fits: how well OBS fits each candidate; see `weights`.
        now_ns: the time, on the clock of `Attempt.time_ns`.
        relapses: how many repairs in a row helped what is suspected, and did not last.
    """
    diagnoses = [one.diagnosis for one in candidates]
    chances = weights(diagnoses, tried, fits=fits, now_ns=now_ns)
    oldest = now_ns - int(MEMORY_S * S_TO_NS)
    recent = [one for one in tried if one.time_ns >= oldest]
    again = [_again(one, recent) * _still_elsewhere(one, candidates, recent) for one in candidates]
    shares = [
        [factor * share for share in _shares(one, candidates)]
        for one, factor in zip(candidates, again, strict=True)
    ]
    weighed = [
        _weigh(one, chance, sum(map(mul, row, chances)), len(candidates), recent)
        for one, chance, row in zip(candidates, chances, shares, strict=True)
    ]
    worth = _worth(candidates, shares, chances)
    weighed = [
        one if index in worth or one.helps >= SURE else _spared(one, NOT_WORTH)
        for index, one in enumerate(weighed)
    ]
    if relapses >= patience.relapses - 1:
        why = "power is not cut again for what soon comes back"
        weighed = [_spared(one, why) if power_cuts(one.plan) else one for one in weighed]
    beyond = _beyond(candidates, weighed, shares)
    ranked = sorted(weighed, key=lambda one: (-one.score, one.plan.cost, len(one.diagnosis.bad)))
    best = _cutting_less(next((one for one in ranked if one.score > 0), None), ranked)
    cost = _expected_cost(candidates, shares, chances)
    if best is None:
        reason = _first(beyond, _nothing(candidates, ranked))
        return Choice(None, None, None, tuple(ranked), cost, reason, beyond=beyond)
    probe, probe_cost = _best_look(candidates, shares, chances, looks)
    if probe is not None and probe_cost < cost:
        reason = f"looking at {probe.atom} first: expected cost {probe_cost:.3g} instead of {cost:.3g}"
        return Choice(best.diagnosis, best.plan, probe, tuple(ranked), probe_cost, reason, yes=best.yes)
    if common is not None and common.plan.outcome is Outcome.SOLVED and common.plan.steps:
        saving = (1 - best.helps) * (best.plan.cost - common.plan.cost)
        if saving > LOOK_COST:
            names = ", ".join(common.diagnosis.bad)
            reason = f"every leading diagnosis blames {names}: repaired first, then looked at again"
            return Choice(
                common.diagnosis, common.plan, None, tuple(ranked), cost - saving, reason, yes=common.yes
            )
    reason = _first(beyond, best.reason)
    return Choice(best.diagnosis, best.plan, None, tuple(ranked), cost, reason, beyond=beyond, yes=best.yes)


# --- weighing -------------------------------------------------------------------------------------


def _shares(one: Candidate, candidates: Sequence[Candidate]) -> list[float]:
    """Return how probably a plan helps if it is this diagnosis, for each; part of its own counts in part."""
    if not one.plan.steps:
        return [0.0] * len(candidates)
    repaired = repaired_by(one.plan) | one.carried
    found = []
    for other in candidates:
        bad = frozenset(other.diagnosis.bad)
        mended = bad & repaired if bad <= repaired or other is one else frozenset[str]()
        cure = other.remedy * cured(one.plan, mended, other.works, one.carried, one.rates)
        found.append(cure * len(mended) / len(bad) if mended else 0.0)
    return found


def _again(one: Candidate, tried: Sequence[Attempt]) -> float:
    """Return what is left of a plan's probability to help, as the same was done before in vain.

    Even if the diagnosis is right: a process may come up well once more, a device hardly does.
    """
    bad, plan = frozenset(one.diagnosis.bad), one.plan
    # What is started after it had ended, and what is restarted, should become good by the same act.
    cures = {str(step) for step in plan.steps if any(map(makes_good, step.effects))}
    by_cycle = bad <= cycled(plan) | one.carried
    in_vain = sum(
        attempt.effect_seen
        and ((bad <= attempt.bad and cures <= set(attempt.actions)) or (by_cycle and bad <= attempt.cycled))
        for attempt in tried
        if not attempt.helped
    )
    if not in_vain:
        return 1.0
    seldom = one.remedy < 1 or power_cuts(plan)
    second = SEEN_FACTOR if seldom else AGAIN_FACTOR
    return second * SEEN_FACTOR ** (in_vain - 1)


def _still_elsewhere(one: Candidate, candidates: Sequence[Candidate], tried: Sequence[Attempt]) -> float:
    """Return what is left of a plan's probability to help, as what is probably wrong is none of its suspects,
    and to act on another of them was in vain: the more so.
    """
    bad = frozenset(one.diagnosis.bad)
    others = [frozenset(other.diagnosis.bad) for other in candidates if other.elsewhere]
    vain = (each.effect_seen and not each.helped and each.bad in others for each in tried if each.bad != bad)
    return SEEN_FACTOR if one.elsewhere and any(vain) else 1.0


def _effort(one: Candidate) -> float:
    """Return what a plan costs, with what it darkens; a free one next to nothing."""
    return max(one.plan.cost + DARK_COST * len(one.darkens), 1e-6)


def _weigh(one: Candidate, chance: float, helps: float, rivals: int, tried: Sequence[Attempt]) -> Alternative:
    bad = frozenset(one.diagnosis.bad)
    plan = one.plan
    # Also what was repaired together with something else: done again alone, it is the same.
    failures = [attempt for attempt in tried if bad <= attempt.bad and not attempt.helped]
    score = helps / _effort(one)
    names = ", ".join(one.diagnosis.bad) or "nothing"
    if plan.outcome is Outcome.GAVE_UP:
        reason = f"{names}: no plan was found in time"
    elif not plan.steps:
        reason = "; ".join(plan.unreachable) or f"{names}: nothing to do"
    else:
        reason = f"{names}: {_how_probably(helps, rivals, plan.cost)}"
        if rated := rates_in(plan, bad, one.rates):
            reason += f"; {', '.join(map(str, rated))}"
        if one.darkens:
            reason += f"; it cuts the power of what works: {', '.join(sorted(one.darkens))}"
        if one.yes:
            reason += f"; {one.yes}"
        if plan.unreachable:
            reason += f"; not all of it: {'; '.join(plan.unreachable)}"
    vain = [attempt for attempt in failures if attempt.lasted]
    if vain:
        seen = sum(attempt.effect_seen for attempt in vain)
        worked = {0: "took no effect", len(vain): "took effect"}.get(seen, f"took effect {seen} times")
        reason += f"; repaired {_times(vain)} before without help: its actions {worked}"
    if len(vain) < len(failures):
        short = [attempt for attempt in failures if not attempt.lasted]
        reason += f"; repaired {_times(short)} before, and soon it was broken again"
    told = (chance, helps, score, len(failures), reason)
    return Alternative(one.diagnosis, plan, *told, darkens=one.darkens, yes=one.yes)


def makes_good(effect: Literal) -> bool:
    """Return whether a component is good by this effect."""
    return effect.positive and effect.atom.predicate == "good"


def _times(attempts: Sequence[Attempt]) -> str:
    return "once" if len(attempts) == 1 else f"{len(attempts)} times"


def _how_probably(helps: float, rivals: int, cost: float) -> str:
    """Say how probably a plan helps, and at which cost, where it has rivals. What nobody doubts rests on the
    model: that is said instead of "1".
    """
    if helps < CERTAIN:
        return f"helps with probability {helps:.2g} at cost {cost:g}"
    if rivals == 1:
        return "the only cause that the model knows for this"
    return f"helps whichever of the suspected causes it is, at cost {cost:g}"


CERTAIN = 0.995
"""From here on two digits would say 1."""

SURE = 0.5
"""What helps as probably as this is done, whatever it costs: a person would try it, too."""


NOT_WORTH = "of less use than to ask a person"

PROBABLY = 2 / 3
"""What is twice as probable as all else together, and no act mends it, is told before anything is done."""

LEAST_GAIN = 1e-6
"""Costs that differ by less are equal."""


def _worth(
    candidates: Sequence[Candidate],
    shares: Sequence[Sequence[float]],
    chances: Sequence[float],
) -> frozenset[int]:
    """Return the plans that are worth doing, as indices: to carry them out, best first, and to ask a person
    when they have failed costs less in the mean than to ask at once, or after fewer of them.
    """
    order, costs = _costs(candidates, shares, chances)
    least = min(costs)
    return frozenset(order[: next(n for n, cost in enumerate(costs) if cost < least + LEAST_GAIN)])


def _spared(one: Alternative, why: str) -> Alternative:
    """Return the alternative, not to be done."""
    return replace(one, score=0.0, reason=f"{one.reason}; {why}", spared=True) if one.score > 0 else one


def _beyond(
    candidates: Sequence[Candidate], weighed: Sequence[Alternative], shares: Sequence[Sequence[float]]
) -> str:
    """Return what is probably wrong and no act mends, as a sentence; nothing where that is not clear."""
    elsewhere = dict.fromkeys(one.elsewhere for one in candidates if one.elsewhere)
    suspected = sum(one.weight for one, of in zip(weighed, candidates, strict=True) if of.elsewhere)
    if suspected >= PROBABLY:
        return f"probably {'; '.join(elsewhere)}; a person is needed"
    most = max(range(len(weighed)), key=lambda index: weighed[index].weight, default=None)
    if most is None or len(weighed) == 1 or weighed[most].weight < PROBABLY:
        return ""
    if any(one.score > 0 and row[most] >= MENDS for one, row in zip(weighed, shares, strict=True)):
        return ""
    bad = weighed[most].diagnosis.bad
    return f"probably {' and '.join(bad)} {'itself' if len(bad) == 1 else 'themselves'}: a person is needed"


MENDS = 0.1
"""A plan that cures what is wrong less often does not mend it, as far as a person is concerned."""


def _first(beyond: str, reason: str) -> str:
    return f"{beyond}; {reason}" if beyond else reason


TIED = 0.5
"""Diagnoses are tied whose weights differ by no more than this factor."""


def _cutting_less(best: Alternative | None, ranked: Sequence[Alternative]) -> Alternative | None:
    """Return the best one, or one that cuts less power and costs less: one tied with it that was not tried
    yet, or any that darkens less of what works.
    """
    while best is not None:
        cut, weight, cost, dark = power_cuts(best.plan), best.weight, best.plan.cost, best.darkens
        less = [
            one
            for one in ranked
            if one.score > 0
            and one.plan.cost < cost
            and power_cuts(one.plan) < cut
            and (one.darkens < dark or (not one.failures and one.weight >= TIED * weight))
        ]
        if not less:
            return best
        best = min(less, key=lambda one: (len(power_cuts(one.plan)), -one.score))
    return None


TOLD = 4
"""Reasons in one sentence why there is no repair: with five broken devices there are dozens, much alike."""


def _nothing(candidates: Sequence[Candidate], weighed: Sequence[Alternative]) -> str:
    if not candidates:
        return "nothing is diagnosed bad"
    sentences = dict.fromkeys(
        sentence for one in candidates if not one.plan.steps for sentence in _why_unplanned(one)
    )
    for one in weighed:
        if one.plan.steps and one.failures and not (one.spared and power_cuts(one.plan)):
            sentences[f"{' and '.join(one.diagnosis.bad)} was repaired before, and it did not help"] = None
        elif one.plan.steps:
            sentences[one.reason] = None
    for of in candidates:
        if of.elsewhere and not of.plan.steps:
            sentences[f"to act on {' and '.join(of.diagnosis.bad)} is no remedy for that"] = None
    mending = (of for of in candidates if not of.elsewhere)
    aside = sorted({name for of in mending for name in of.plan.excluded if name in of.diagnosis.bad})
    if aside:
        repairs = "its repairs keep" if len(aside) == 1 else "their repairs keep"
        sentences[f"{' and '.join(aside)} left alone for a while, as {repairs} failing or do not last"] = None
    told = list(sentences)[:TOLD]
    if len(sentences) > TOLD:
        told.append(counted(len(sentences) - TOLD, "more reason"))
    late = any(one.plan.outcome is Outcome.GAVE_UP for one in candidates)
    known = "no repair was found in time" if late else "no known repair"
    return f"{known}: {'; '.join(told)}{_suspects(weighed)}"


def _suspects(weighed: Sequence[Alternative]) -> str:
    """Name what is most suspected, where what was done has told the suspects apart: there a person begins."""
    if len(weighed) < 2 or not any(one.failures for one in weighed):
        return ""
    return f"; {suspected_most((one.diagnosis, one.weight) for one in weighed)}"


SUSPECTED = "suspected most: "


def suspected_most(weighed: Iterable[tuple[Diagnosis, float]]) -> str:
    """Name the most probable of some diagnoses with their weights."""
    by_weight = sorted(weighed, key=lambda one: -one[1])[:TOLD]
    named = (f"{' and '.join(diagnosis.bad)} ({weight:.0%} likely)" for diagnosis, weight in by_weight)
    return f"{SUSPECTED}{', '.join(named)}"


def _why_unplanned(one: Candidate) -> tuple[str, ...]:
    """Return why there is no plan: the goals that nothing reaches, and that the time ran out if it did."""
    names = " and ".join(one.diagnosis.bad)
    if one.plan.outcome is Outcome.GAVE_UP:
        return (*one.plan.unreachable, f"no plan for {names} was found in time")
    if one.plan.unreachable:
        return one.plan.unreachable
    return () if set(one.diagnosis.bad) & set(one.plan.excluded) else (f"nothing to do about {names}",)


def _expected_cost(
    candidates: Sequence[Candidate],
    shares: Sequence[Sequence[float]],
    chances: Sequence[float],
) -> float:
    """Return the expected cost of repairing, best first, until it helps or a person must come; less what a
    person's yes to it costs.
    """
    return min(_costs(candidates, shares, chances, ask_cost=0.0)[1])


def _costs(
    candidates: Sequence[Candidate],
    shares: Sequence[Sequence[float]],
    chances: Sequence[float],
    ask_cost: float = ASK_COST,
) -> tuple[list[int], list[float]]:
    """Return the plans as indices, best first, and the expected cost of repairing by them, where a person is
    called after none of them, after one, and so on.
    """
    left = list(chances)
    unused = [index for index, one in enumerate(candidates) if one.plan.steps]
    efforts = [_effort(one) + ask_cost * bool(one.asks or one.yes) for one in candidates]
    spent = 0.0
    order: list[int] = []
    found = [PERSON_COST * sum(left)]
    while unused:
        gains = {index: sum(map(mul, shares[index], left)) for index in unused}
        best = max(unused, key=lambda index: gains[index] / efforts[index])
        if gains[best] <= 0:
            break
        unused.remove(best)
        order.append(best)
        spent += efforts[best] * sum(left)
        left = [chance * (1 - share) for chance, share in zip(left, shares[best], strict=True)]
        found.append(spent + PERSON_COST * sum(left))
    return order, found


def _best_look(
    candidates: Sequence[Candidate],
    shares: Sequence[Sequence[float]],
    chances: Sequence[float],
    looks: Sequence[Look],
) -> tuple[Look | None, float]:
    """Return the look after which repairing is expected to be cheapest, and that cost with the look's own."""
    best: Look | None = None
    least = float("inf")
    for look in looks:
        total = look.cost
        for value in (True, False):
            split = [
                chance * (0.5 if predicted is None else float(predicted == value))
                for chance, predicted in zip(chances, look.predicted, strict=True)
            ]
            total += _expected_cost(candidates, shares, split)
        if total < least:
            best, least = look, total
    return best, least
