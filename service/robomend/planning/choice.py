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
    power                   is not cut on a tie that a cheaper act would break: while another diagnosis, as
                            probable, can be repaired with less of it and was not tried, that comes first;
                            nor for what soon came back after each of the last two repairs (quarantine.py)
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
from robomend.planning.cures import cured
from robomend.planning.plan import Outcome, Plan
from robomend.planning.quarantine import Quarantined
from robomend.planning.tried import DEFAULT_PATIENCE, S_TO_NS, Attempt, Patience, repaired_by, weights
from robomend_client.counts import counted
from robomend_client.literals import Atom, Literal


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
    spared: bool = False  # it is not done as it would cut power


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
    chances = weights(diagnoses, tried, fits=fits, now_ns=now_ns, patience=patience)
    oldest = now_ns - int(patience.memory_s * S_TO_NS)
    recent = [one for one in tried if one.time_ns >= oldest]
    weighed = [
        _weigh(one, chance, candidates, chances, recent, patience)
        for one, chance in zip(candidates, chances, strict=True)
    ]
    if relapses >= patience.relapses - 1:
        weighed = [_spared(one, "power is not cut again for what soon comes back") for one in weighed]
    elif not _cutting_pays(candidates, chances, patience):
        weighed = [one if one.helps >= SURE else _spared(one) for one in weighed]
    ranked = sorted(weighed, key=lambda one: (-one.score, one.plan.cost, len(one.diagnosis.bad)))
    best = _cutting_less(next((one for one in ranked if one.score > 0), None), ranked)
    cost = _expected_cost(candidates, chances, patience)
    if best is None:
        return Choice(None, None, None, tuple(ranked), cost, _nothing(candidates, ranked))
    probe, probe_cost = _best_look(candidates, chances, looks, patience)
    if probe is not None and probe_cost < cost:
        reason = f"looking at {probe.atom} first: expected cost {probe_cost:.3g} instead of {cost:.3g}"
        return Choice(best.diagnosis, best.plan, probe, tuple(ranked), probe_cost, reason)
    if common is not None and common.plan.outcome is Outcome.SOLVED and common.plan.steps:
        saving = (1 - best.helps) * (best.plan.cost - common.plan.cost)
        if saving > patience.look_cost:
            names = ", ".join(common.diagnosis.bad)
            reason = f"every leading diagnosis blames {names}: repaired first, then looked at again"
            return Choice(common.diagnosis, common.plan, None, tuple(ranked), cost - saving, reason)
    return Choice(best.diagnosis, best.plan, None, tuple(ranked), cost, best.reason)


def power_cuts(plan: Plan) -> frozenset[str]:
    """Return the devices that the plan takes power from."""
    return frozenset(
        effect.atom.args[0]
        for step in plan.steps
        for effect in step.effects
        if effect.positive and effect.atom.predicate == "off" and effect.atom.args
    )


# --- weighing -------------------------------------------------------------------------------------


def _helps(
    plan: Plan, own: Diagnosis | None, candidates: Sequence[Candidate], chances: Sequence[float]
) -> float:
    """Return the probability that a plan helps; a plan for part of its own diagnosis counts in part."""
    repaired = repaired_by(plan)
    total = 0.0
    for one, chance in zip(candidates, chances, strict=True):
        bad = frozenset(one.diagnosis.bad)
        if bad <= repaired:
            total += chance * cured(plan, bad, one.works)
        elif one.diagnosis is own and bad & repaired:
            total += chance * cured(plan, bad & repaired, one.works) * len(bad & repaired) / len(bad)
    return total


def _weigh(
    one: Candidate,
    chance: float,
    candidates: Sequence[Candidate],
    chances: Sequence[float],
    tried: Sequence[Attempt],
    patience: Patience,
) -> Alternative:
    bad = frozenset(one.diagnosis.bad)
    plan = one.plan
    helps = _helps(plan, one.diagnosis, candidates, chances) if plan.steps else 0.0
    # Also what was repaired together with something else: done again alone, it is the same.
    failures = [attempt for attempt in tried if bad <= attempt.bad and not attempt.helped]
    # What is started after it had ended, and what is restarted, should become good by the same act.
    cures = {str(step) for step in plan.steps if any(map(_makes_good, step.effects))}
    in_vain = sum(attempt.effect_seen and cures <= set(attempt.actions) for attempt in failures)
    if in_vain:  # even if the diagnosis is right: a process may come up well once more, a device hardly does
        second = patience.seen_factor if power_cuts(plan) else patience.again_factor
        helps *= second * patience.seen_factor ** (in_vain - 1)
    # A plan of free actions is as good as one that costs next to nothing.
    pays = not in_vain or helps * patience.person_cost > plan.cost
    score = helps / max(plan.cost, 1e-6) if pays else 0.0
    names = ", ".join(one.diagnosis.bad) or "nothing"
    if plan.outcome is Outcome.GAVE_UP:
        reason = f"{names}: no plan was found in time"
    elif not plan.steps:
        reason = "; ".join(plan.unreachable) or f"{names}: nothing to do"
    else:
        reason = f"{names}: {_how_probably(helps, candidates)} at cost {plan.cost:g}"
        if plan.unreachable:
            reason += f"; not all of it: {'; '.join(plan.unreachable)}"
    vain = [attempt for attempt in failures if attempt.lasted]
    if vain:
        seen, of = sum(attempt.effect_seen for attempt in vain), counted(len(vain), "time")
        reason += f"; repaired {_times(vain)} before without help; its acts worked {seen} of {of}"
    if len(vain) < len(failures):
        short = [attempt for attempt in failures if not attempt.lasted]
        reason += f"; repaired {_times(short)} before, and soon it was broken again"
    return Alternative(one.diagnosis, plan, chance, helps, score, len(failures), reason)


def _makes_good(effect: Literal) -> bool:
    return effect.positive and effect.atom.predicate == "good"


def _times(attempts: Sequence[Attempt]) -> str:
    return "once" if len(attempts) == 1 else f"{len(attempts)} times"


def _how_probably(helps: float, candidates: Sequence[Candidate]) -> str:
    """Say how probably a plan helps. What nobody doubts rests on the model: that is said instead of "1"."""
    if helps < CERTAIN:
        return f"helps with probability {helps:.2g}"
    if len(candidates) == 1:
        return "the only cause that the model knows for this; to be repaired"
    return "helps whichever of the suspected causes it is,"


CERTAIN = 0.995
"""From here on two digits would say 1."""

SURE = 0.5
"""What helps as probably as this is done, whatever it costs: a person would try it, too."""


def _cutting_pays(candidates: Sequence[Candidate], chances: Sequence[float], patience: Patience) -> bool:
    """Return whether to go on with plans that cut power costs less in the mean than to call a person
    when the others have failed.
    """
    spare = [one for one in candidates if not power_cuts(one.plan)]
    if len(spare) == len(candidates):
        return True
    least = min(_costs(candidates, chances, patience, candidates))
    return least < min(_costs(candidates, chances, patience, spare)) - LEAST_GAIN


LEAST_GAIN = 1e-6
"""Costs that differ by less are equal."""


def _spared(one: Alternative, why: str = "too little to cut power for") -> Alternative:
    """Return the alternative, not to be done if it cuts power."""
    if one.score <= 0 or not power_cuts(one.plan):
        return one
    return replace(one, score=0.0, reason=f"{one.reason}; {why}", spared=True)


TIED = 0.5
"""Diagnoses are tied whose weights differ by no more than this factor."""


def _cutting_less(best: Alternative | None, ranked: Sequence[Alternative]) -> Alternative | None:
    """Return the best one, or one tied with it that cuts less power, costs less and was not tried yet."""
    while best is not None:
        cut, weight, cost = power_cuts(best.plan), best.weight, best.plan.cost
        less = [
            one
            for one in ranked
            if one.score > 0
            and not one.failures
            and one.weight >= TIED * weight
            and one.plan.cost < cost
            and power_cuts(one.plan) < cut
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
        if one.plan.steps and one.failures and not one.spared:
            sentences[f"{' and '.join(one.diagnosis.bad)} was repaired before, and it did not help"] = None
        elif one.plan.steps:
            sentences[one.reason] = None
    aside = sorted({name for one in candidates for name in one.plan.excluded if name in one.diagnosis.bad})
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
    named = (f"{' and '.join(diagnosis.bad)} (weight {weight:.2g})" for diagnosis, weight in by_weight)
    return f"{SUSPECTED}{', '.join(named)}"


def _why_unplanned(one: Candidate) -> tuple[str, ...]:
    """Return why there is no plan: the goals that nothing reaches, and that the time ran out if it did."""
    names = " and ".join(one.diagnosis.bad)
    if one.plan.outcome is Outcome.GAVE_UP:
        return (*one.plan.unreachable, f"no plan for {names} was found in time")
    if one.plan.unreachable:
        return one.plan.unreachable
    return () if set(one.diagnosis.bad) & set(one.plan.excluded) else (f"nothing to do about {names}",)


def _expected_cost(candidates: Sequence[Candidate], chances: Sequence[float], patience: Patience) -> float:
    """Return the expected cost of repairing, best first, until it helps or a person must come."""
    return _costs(candidates, chances, patience, candidates)[-1]


def _costs(
    candidates: Sequence[Candidate],
    chances: Sequence[float],
    patience: Patience,
    usable: Sequence[Candidate],
) -> list[float]:
    """Return the expected cost of repairing by the usable plans, best first, where a person is called after
    none of them, after one, and so on.
    """
    left = list(chances)
    unused = [one for one in usable if one.plan.steps]
    shares = {id(one): _shares(one.plan, candidates) for one in unused}
    spent = 0.0
    found = [patience.person_cost * sum(left)]
    while unused:
        gains = [sum(map(mul, shares[id(one)], left)) for one in unused]
        index = max(range(len(unused)), key=lambda i: gains[i] / max(unused[i].plan.cost, 1e-6))
        if gains[index] <= 0:
            break
        best = unused.pop(index)
        spent += best.plan.cost * sum(left)
        left = [chance * (1 - share) for chance, share in zip(left, shares[id(best)], strict=True)]
        found.append(spent + patience.person_cost * sum(left))
    return found


def _shares(plan: Plan, candidates: Sequence[Candidate]) -> list[float]:
    """Return how probably the plan helps if it is this diagnosis, for each."""
    repaired = repaired_by(plan)
    return [
        cured(plan, one.diagnosis.bad, one.works) if repaired.issuperset(one.diagnosis.bad) else 0.0
        for one in candidates
    ]


def _best_look(
    candidates: Sequence[Candidate], chances: Sequence[float], looks: Sequence[Look], patience: Patience
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
            total += _expected_cost(candidates, split, patience)
        if total < least:
            best, least = look, total
    return best, least
