"""Which repair to do next: pure, from diagnoses, their plans, what was tried, and what could be looked at.

The paper repairs the first diagnosis. Here each leading diagnosis is planned for, and the order is that of
decision-theoretic troubleshooting: repair, look, repair the next. With probability p(i) that repair i helps
and cost c(i), the expected cost Σ c(i) · P(none before i helped) is least in order of p(i) / c(i).

    weight of a diagnosis   its posterior, or without priors one factor a component (small sets first) and
                            how well what works fits it (robomend.diagnosis.likelihood); lowered by each
                            repair of it that did not help: much when its effect was seen (the power is back
                            and still nothing: it was not that), little when it was not
    p(plan)                 weight of all diagnoses whose components the plan repairs: a power cycle that
                            restarts the driver helps against a bad device and against a bad driver; lowered
                            for a plan that was carried out before, with its effects seen, and did not help
    common part             components that every leading diagnosis blames are repaired first, by
                            themselves, if what is saved when the first full repair is wrong exceeds the
                            cost of one more look
    power                   is not cut on a tie that a cheaper act would break: while another diagnosis, as
                            probable, can be repaired with less of it and was not tried, that comes first
    probe                   if looking first makes the expected cost, the look included, smaller
    quarantine              a component whose repairs keep failing is left alone for a time: quarantine.py

So {jaguar} and {jaguar_node}, which the six clause schemes leave tied once the power is back and odometry is
still silent, are told apart: the device was tried, its effect was seen, so the driver is restarted, and power
is never cycled for ever.

Source: D. Heckerman, J. Breese, K. Rommelse. Decision-theoretic troubleshooting. CACM 38(3), 1995.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

from robomend.diagnosis.result import Diagnosis
from robomend.planning.plan import Outcome, Plan
from robomend_client.literals import Atom

S_TO_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Attempt:
    """The memory of one repair attempt."""

    bad: frozenset[str]  # the diagnosis that was repaired
    repaired: frozenset[str]  # every component that the steps done were to make good
    time_ns: int
    effect_seen: bool  # each action's effect was seen
    helped: bool  # the next diagnosis no longer blamed `bad`
    actions: tuple[str, ...] = ()  # as text, for people


@dataclass(frozen=True, slots=True)
class Look:
    """A probe as choosing sees it; see robomend.diagnosis.probes for where they come from."""

    atom: Atom
    cost: float  # in the unit of action costs, about seconds
    predicted: tuple[bool | None, ...]  # what each candidate's diagnosis predicts, in order; None: nothing


@dataclass(frozen=True, slots=True)
class Patience:
    """How choosing weighs what happened. The defaults suit a robot that is watched from afar."""

    component_odds: float = 0.01  # P(AB) / P(¬AB) where nobody gave priors
    seen_factor: float = 0.1  # a repair whose effect was seen and that did not help
    unseen_factor: float = 0.5  # one whose effect was not seen
    memory_s: float = 3600.0  # how long an attempt lowers its diagnosis
    look_cost: float = 2.0  # of one more round of repair and diagnosis
    person_cost: float = 300.0  # when every repair failed and somebody must come
    least_help: float = 0.001  # what was done in vain is not repeated below this probability of helping
    attempts: int = 3  # failures in a row until quarantine
    relapses: int = 6  # the same for repairs that helped, and not for long
    relapse_s: float = 60.0  # what needs a repair again so soon was not mended by the last one
    backoff_s: float = 300.0  # the first quarantine; doubled by each further failure …
    max_backoff_s: float = 86_400.0  # … up to this
    leading: int = 6  # how many diagnoses are planned for


@dataclass(frozen=True, slots=True)
class Candidate:
    """A diagnosis and its plan."""

    diagnosis: Diagnosis
    plan: Plan


@dataclass(frozen=True, slots=True)
class Alternative:
    """A candidate as it was weighed."""

    diagnosis: Diagnosis
    plan: Plan
    weight: float  # P(this diagnosis), what was tried taken into account; all weights sum to 1
    helps: float  # P(the plan helps)
    score: float  # helps per cost
    failures: int  # times that this very diagnosis was repaired and it did not help
    reason: str


@dataclass(frozen=True, slots=True)
class Choice:
    """What to do next: a plan, or a probe first, or nothing, with the reason in words."""

    diagnosis: Diagnosis | None
    plan: Plan | None
    probe: Look | None
    alternatives: tuple[Alternative, ...]  # best first; the chosen one included
    expected_cost: float  # of repairing in this order until it helps
    reason: str


def weights(
    diagnoses: Sequence[Diagnosis],
    tried: Iterable[Attempt] = (),
    *,
    fits: Sequence[float] | None = None,
    now_ns: int = 0,
    patience: Patience = Patience(),
) -> list[float]:
    """Return P(diagnosis) for each, attempts taken into account; they sum to 1.

    `fits`: how well OBS fits each, as far as the probabilities do not have it in them.
    """
    if diagnoses and all(diagnosis.probability is not None for diagnosis in diagnoses):
        raw = [diagnosis.probability or 0.0 for diagnosis in diagnoses]
    else:
        # Relative to the smallest, so that a hundred bad components do not underflow.
        least = min((len(diagnosis.bad) for diagnosis in diagnoses), default=0)
        raw = [patience.component_odds ** (len(diagnosis.bad) - least) for diagnosis in diagnoses]
    if fits is not None:
        raw = [odds * fit for odds, fit in zip(raw, fits, strict=True)]
    oldest = now_ns - int(patience.memory_s * S_TO_NS)
    failed = [one for one in tried if not one.helped and one.time_ns >= oldest]
    for position, diagnosis in enumerate(diagnoses):
        bad = frozenset(diagnosis.bad)
        for one in failed:
            if bad == one.bad or (bad and bad <= one.repaired):
                raw[position] *= patience.seen_factor if one.effect_seen else patience.unseen_factor
    total = sum(raw)
    return [value / total if total > 0 else 1 / len(raw) for value in raw]


def leading(
    diagnoses: Sequence[Diagnosis],
    tried: Iterable[Attempt] = (),
    *,
    fits: Sequence[float] | None = None,
    switchable: Collection[str] = (),
    now_ns: int = 0,
    patience: Patience = Patience(),
) -> list[Diagnosis]:
    """Return the diagnoses worth planning for, the most probable first.

    Of equally probable ones those come first that blame fewer of `switchable`, whose repair cuts power.
    """
    found = weights(diagnoses, tried, fits=fits, now_ns=now_ns, patience=patience)
    cuts = [sum(name in switchable for name in diagnosis.bad) for diagnosis in diagnoses]
    order = sorted(range(len(diagnoses)), key=lambda index: (-round(found[index], 12), cuts[index]))
    return [diagnoses[index] for index in order[: patience.leading] if diagnoses[index].bad]


def common_part(diagnoses: Sequence[Diagnosis]) -> tuple[str, ...]:
    """Return the components that every diagnosis blames, if each blames more; else nothing."""
    if len(diagnoses) < 2:
        return ()
    shared = frozenset.intersection(*(frozenset(diagnosis.bad) for diagnosis in diagnoses))
    if not shared or any(len(diagnosis.bad) == len(shared) for diagnosis in diagnoses):
        return ()
    return tuple(name for name in diagnoses[0].bad if name in shared)


def repaired_by(plan: Plan) -> frozenset[str]:
    """Return the components that the plan makes good (again) and leaves good."""
    state: dict[str, bool] = {}
    for step in plan.steps:
        for effect in step.effects:
            if effect.atom.predicate == "good" and len(effect.atom.args) == 1:
                state[effect.atom.args[0]] = effect.positive
    return frozenset(name for name, good in state.items() if good)


def choose(
    candidates: Sequence[Candidate],
    tried: Sequence[Attempt] = (),
    looks: Sequence[Look] = (),
    *,
    common: Candidate | None = None,
    fits: Sequence[float] | None = None,
    now_ns: int = 0,
    patience: Patience = Patience(),
) -> Choice:
    """Return what to do next.

    Args:
        candidates: the leading diagnoses with their plans.
        tried: earlier attempts, in any order.
        looks: probes that somebody can make now.
        common: the plan for `common_part`, if there is one.
        fits: how well OBS fits each candidate; see `weights`.
        now_ns: the time, on the clock of `Attempt.time_ns`.
    """
    diagnoses = [one.diagnosis for one in candidates]
    chances = weights(diagnoses, tried, fits=fits, now_ns=now_ns, patience=patience)
    oldest = now_ns - int(patience.memory_s * S_TO_NS)
    recent = [one for one in tried if one.time_ns >= oldest]
    weighed = [
        _weigh(one, chance, candidates, chances, recent, patience)
        for one, chance in zip(candidates, chances, strict=True)
    ]
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


def attempt(
    diagnosis: Diagnosis,
    plan: Plan,
    *,
    done: Collection[int] | None,
    time_ns: int,
    effect_seen: bool,
    helped: bool,
) -> Attempt:
    """Return the memory of a repair; `done` are the indices of the steps that were carried out, None: all."""
    steps = tuple(step for step in plan.steps if done is None or step.index in done)
    return Attempt(
        frozenset(diagnosis.bad),
        repaired_by(replace(plan, steps=steps)),
        time_ns,
        effect_seen,
        helped,
        tuple(map(str, steps)),
    )


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
            total += chance
        elif one.diagnosis is own and bad & repaired:
            total += chance * len(bad & repaired) / len(bad)
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
    failures = [attempt for attempt in tried if attempt.bad == bad and not attempt.helped]
    texts = {str(step) for step in plan.steps}
    in_vain = sum(attempt.effect_seen and texts <= set(attempt.actions) for attempt in failures)
    helps *= patience.seen_factor**in_vain  # even if the diagnosis is right, the same again hardly cures it
    # A plan of free actions is as good as one that costs next to nothing.
    score = 0.0 if in_vain and helps < patience.least_help else helps / max(plan.cost, 1e-6)
    names = ", ".join(one.diagnosis.bad) or "nothing"
    if plan.outcome is Outcome.GAVE_UP:
        reason = f"{names}: no plan was found in time"
    elif not plan.steps:
        reason = "; ".join(plan.unreachable) or f"{names}: nothing to do"
    else:
        reason = f"{names}: helps with probability {helps:.2g} at cost {plan.cost:g}"
        if plan.unreachable:
            reason += f"; not all of it: {'; '.join(plan.unreachable)}"
    if failures:
        seen = sum(attempt.effect_seen for attempt in failures)
        times = "once" if len(failures) == 1 else f"{len(failures)} times"
        reason += f"; repaired {times} before without help, effect seen {seen} of {len(failures)}"
    return Alternative(one.diagnosis, plan, chance, helps, score, len(failures), reason)


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


def _nothing(candidates: Sequence[Candidate], weighed: Sequence[Alternative]) -> str:
    if not candidates:
        return "nothing is diagnosed bad"
    sentences = dict.fromkeys(
        sentence
        for one in candidates
        if not one.plan.steps
        for sentence in one.plan.unreachable or _unplanned(one)
    )
    for one in weighed:
        if one.plan.steps:
            sentences[f"{' and '.join(one.diagnosis.bad)} was repaired before, and it did not help"] = None
    aside = sorted({name for one in candidates for name in one.plan.excluded if name in one.diagnosis.bad})
    if aside:
        repairs = "its repairs keep" if len(aside) == 1 else "their repairs keep"
        sentences[f"{' and '.join(aside)} left alone for a while, as {repairs} failing"] = None
    return "no known repair: " + "; ".join(sentences)


def _unplanned(one: Candidate) -> tuple[str, ...]:
    """Return why there is no plan where no goal is at fault."""
    names = " and ".join(one.diagnosis.bad)
    if one.plan.outcome is Outcome.GAVE_UP:
        return (f"no plan for {names} was found in time",)
    return () if set(one.diagnosis.bad) & set(one.plan.excluded) else (f"nothing to do about {names}",)


def _expected_cost(candidates: Sequence[Candidate], chances: Sequence[float], patience: Patience) -> float:
    """Return the expected cost of repairing, best first, until it helps or a person must come."""
    left = list(chances)
    unused = [one for one in candidates if one.plan.steps]
    covers = {id(one): repaired_by(one.plan) for one in unused}
    total = 0.0
    while unused:
        gains = [_covered(covers[id(one)], candidates, left) for one in unused]
        index = max(range(len(unused)), key=lambda i: gains[i] / max(unused[i].plan.cost, 1e-6))
        if gains[index] <= 0:
            break
        best = unused.pop(index)
        total += best.plan.cost * sum(left)
        left = [
            0.0 if frozenset(other.diagnosis.bad) <= covers[id(best)] else chance
            for other, chance in zip(candidates, left, strict=True)
        ]
    return total + patience.person_cost * sum(left)


def _covered(repaired: frozenset[str], candidates: Sequence[Candidate], chances: Sequence[float]) -> float:
    """Return the weight of the diagnoses whose components are all among the repaired."""
    return sum(
        chance
        for one, chance in zip(candidates, chances, strict=True)
        if frozenset(one.diagnosis.bad) <= repaired
    )


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
