"""How probable each diagnosis is, how much was not looked at, and diagnoses in order of probability.

Components fail independently, c with prior p(c). The weight of a diagnosis Δ is that of the state in which
just Δ is abnormal, so that among the diagnoses found

    P(Δ | OBS)  ∝  ∏ p(c) for c ∈ Δ · ∏ (1 - p(c)) for c ∉ Δ  ∝  ∏ p(c) / (1 - p(c)) for c ∈ Δ

times how well OBS fits Δ where the rules say nothing (below; 1 unless a component model says what its
components put out).

Only the priors of components that a diagnosis blames matter: the rest cancels. If one of those has no
prior, there is no probability at all; no default is made up. All sums are in log space: a thousand priors
of 1e-9 underflow.

What was not enumerated: each state that OBS allows hits every conflict, and each state that extends a
diagnosis found is accounted for. So at most

    P(every known conflict is hit) - P(some diagnosis found is contained)

is left. The first is bounded by a product over conflicts without a common component, the second from below
by what each diagnosis adds to those before it. Under fault models in which abnormal parts must misbehave,
extending a diagnosis may break it, so there each diagnosis accounts for its own state only.

Sources:
    J. de Kleer, B. Williams. Diagnosing multiple faults. AIJ 32(1), 1987 (priors, posterior).
    J. de Kleer. Focusing on probable diagnoses. AAAI 1991 (the most probable first).

The likelihood of OBS, where the six schemes say nothing: a weak fault model lets a broken component do
anything, so ok(b) speaks neither for nor against a probe that publishes b. People weigh it: what is broken
seldom works. A component c that a diagnosis blames fails

    as a whole    with probability 1 − μ: all that it puts out is bad
    in part       with probability μ: each of its outputs is as likely good as bad

so with k observed outputs  L(c) = (1 − μ)·[all k are bad] + μ·2⁻ᵏ, and the weight of a diagnosis is

    P(Δ | OBS)  ∝  prior odds of Δ · ∏ L(c) for c ∈ Δ

An output counts once, and only if nothing else entails what was seen of it: not where it is bad and an input
is bad, too, nor where it is good and somebody else publishes it whom Δ holds healthy. Without such outputs L
is 1. The outputs of a device are those of the nodes that drive it, or a device that it feeds.

Conflicts and minimal diagnoses stay what they are: this weighs, it does not exclude.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from heapq import heappop, heappush
from math import exp, expm1, fsum, inf, log, log1p, prod

from robomend.diagnosis.guided import CheapestHittingSets
from robomend.diagnosis.masks import bits
from robomend.diagnosis.oracle import Deadline, OutOfTime
from robomend.diagnosis.result import DiagnosisResult, Options
from robomend.errors import ModelError, OptionRefused
from robomend.model.cnf import HealthCnf, Output
from robomend.model.components import ComponentModel
from robomend.model.loops import Loop
from robomend_client.literals import Atom, Literal


def _likelihood(cnf: HealthCnf, seen: Mapping[Atom, bool], bad: Collection[str]) -> float:
    blamed = frozenset(bad)
    counted: set[tuple[str, Atom]] = set()
    factors = []
    for component in sorted(blamed):
        signs = []
        for output in cnf.puts_out.get(component, ()):
            sign = seen.get(output.atom)
            key = (output.by, output.atom)
            if sign is not None and key not in counted and not _entailed(cnf, seen, blamed, output, sign):
                counted.add(key)
                signs.append(sign)
        factors.append((1 - cnf.partial) * (not any(signs)) + cnf.partial * 0.5 ** len(signs))
    return prod(factors)


def likelihoods(
    cnf: HealthCnf, observed: Collection[Literal], diagnoses: Iterable[Collection[str]]
) -> list[float]:
    """Return P(OBS | diagnosis) of each, up to a factor that is the same for all; 1 where nothing is known of
    what components put out.
    """
    if not cnf.puts_out:
        return [1.0 for _ in diagnoses]
    seen = {literal.atom: literal.positive for literal in observed}
    return [_likelihood(cnf, seen, bad) if bad else 1.0 for bad in diagnoses]


def works_in_part(cnf: HealthCnf, observed: Iterable[Literal], bad: Iterable[str]) -> frozenset[str]:
    """Return what is blamed although an output of it is good that nobody else may have put out."""
    seen = {literal.atom: literal.positive for literal in observed}
    blamed = frozenset(bad)
    return frozenset(
        component
        for component in blamed
        for output in cnf.puts_out.get(component, ())
        if seen.get(output.atom) and not _entailed(cnf, seen, blamed, output, True)
    )


def _entailed(
    cnf: HealthCnf, seen: Mapping[Atom, bool], blamed: Collection[str], output: Output, sign: bool
) -> bool:
    """Return whether what was seen of an output says nothing of who puts it out."""
    if not sign:
        return any(seen.get(atom) is False for atom in output.inputs)
    return any(by not in blamed for by in cnf.publishers[output.atom] if by != output.by)


# --- who fell first: in a circle of topics that need each other, the order in which they fell silent.
#
#     ctl: state → cmd, est: cmd → state      ctl hangs: cmd falls, and state as soon as est misses cmd
#
# Both {ctl} and {est} explain it, and both fit what works. But the onset of `not ok(cmd)`, its last good
# sample, is before that of `not ok(state)`, so that ctl is the more probable: a diagnosis all of whose
# outputs in a circle fell later than another topic of it counts for LATER. Samples come once a period, so
# that differences of less than one, the longer of the two, say nothing.

LATER = 0.05
"""How much less probable it makes a diagnosis that what it blames fell after what rests on it."""

PERIOD_S = 0.1
"""Of a topic whose rate the model does not say: that of the observers' default."""


def onset_fit(
    model: ComponentModel,
    cnf: HealthCnf,
    loops: Iterable[Loop],
    onsets: Mapping[Atom, int],
    bad: Collection[str],
) -> float:
    """Return how well a diagnosis fits the order in which topics fell: 1, or LATER for each circle.

    Args:
        onsets: of the topics that are not ok, each with its last good sample, in nanoseconds.
        bad: what the diagnosis blames.
    """
    fit = 1.0
    for loop in loops:
        fallen = {atom: onsets[atom] for atom in loop.atoms if atom in onsets}
        if len(fallen) < 2:
            continue
        own = {
            output.atom
            for name in loop.components.intersection(bad)
            for output in cnf.puts_out.get(name, ())
            if output.atom in fallen
        }
        if not own:
            continue
        first = min(fallen, key=lambda atom: (fallen[atom], atom not in own))
        nearest = min(own, key=lambda atom: fallen[atom])
        period_ns = 1e9 * max(_period_s(model, first), _period_s(model, nearest))
        if fallen[nearest] - fallen[first] > period_ns:
            fit *= LATER
    return fit


def _period_s(model: ComponentModel, atom: Atom) -> float:
    topic = model.topics.get(atom.args[0])
    return PERIOD_S if topic is None or topic.rate_hz is None else 1 / topic.rate_hz


STEP = 1e6
"""Between sizes where diagnoses are listed by size first: more than the log odds of any diagnosis."""

WEIGHED = 1_000
"""Diagnoses that are put in order by weight: some milliseconds. Of more, nobody reads the first few only."""

SCALE = 1 << 20
"""Log odds as integers: their sum over a hundred components is off by 5e-5 at most."""


def check_priors(priors: Mapping[str, float]) -> None:
    """Refuse priors that are no probabilities, or leave no doubt.

    Raises:
        ModelError: a prior is not a number between 0 and 1, both excluded.
    """
    for component, prior in priors.items():
        if not 0 < prior < 1:
            raise ModelError(
                f"the prior of {component} is {prior:g}: give a probability above 0 and below 1; "
                "leave out a component that cannot fail, or withdraw one that is known to be broken"
            )


def log_odds(prior: float) -> float:
    """Return ln(p / (1 - p)), exact for tiny p."""
    return log(prior) - log1p(-prior)


def posterior(
    diagnoses: Sequence[Collection[str]],
    priors: Mapping[str, float],
    given: Collection[str] = (),
    fits: Sequence[float] | None = None,
) -> tuple[float, ...] | None:
    """Return P(Δ | OBS) among the diagnoses found; they sum to 1.

    Args:
        diagnoses: what each blames.
        priors: P(AB(c)); checked.
        given: components that a what-if assumes abnormal: their priors do not count.
        fits: the likelihood of OBS under each, above 0; None: all the same.

    Returns:
        None if there is no diagnosis, no prior, or a blamed component without one.

    Raises:
        ModelError: a prior is not strictly between 0 and 1.
    """
    check_priors(priors)
    assumed = frozenset(given)
    weights = []
    for blamed in diagnoses:
        relevant = [component for component in blamed if component not in assumed]
        if any(component not in priors for component in relevant):
            return None
        weights.append(fsum(log_odds(priors[component]) for component in relevant))
    if not weights or not priors:
        return None
    if fits is not None:
        weights = [weight + log(fit) for weight, fit in zip(weights, fits, strict=True)]
    highest = max(weights)
    shares = [exp(weight - highest) for weight in weights]
    total = fsum(shares)
    return tuple(share / total for share in shares)


def unexplored_mass(
    diagnoses: Sequence[Collection[str]],
    conflicts: Sequence[Collection[str]],
    priors: Mapping[str, float],
    *,
    weak: bool = True,
    components: Collection[str] = (),
) -> float | None:
    """Bound the prior mass of the states that OBS allows and no diagnosis found accounts for.

    Args:
        diagnoses: those found.
        conflicts: those known; more of them give a better bound, none gives 1 less what was found.
        priors: P(AB(c)); a component without one may fail for sure, as far as the bound knows.
        weak: every superset of a diagnosis is one.
        components: COMPS; needed only where `weak` is false.

    Returns:
        None without any priors.
    """
    if not priors:
        return None
    check_priors(priors)
    hit = sorted((_any_fails(conflict, priors), tuple(conflict)) for conflict in conflicts)
    possible = 1.0
    used: set[str] = set()
    for chance, conflict in hit:
        if used.isdisjoint(conflict):
            used.update(conflict)
            possible *= chance
    known = [frozenset(blamed) for blamed in diagnoses if all(c in priors for c in blamed)]
    found = _contained(known, priors) if weak else _exactly(known, priors, components)
    return min(1.0, max(0.0, possible - found))


def _any_fails(conflict: Collection[str], priors: Mapping[str, float]) -> float:
    if any(component not in priors for component in conflict):
        return 1.0
    return -expm1(fsum(log1p(-priors[component]) for component in conflict))


def _all_fail(blamed: Collection[str], priors: Mapping[str, float]) -> float:
    return exp(fsum(log(priors[component]) for component in blamed))


def _contained(diagnoses: Sequence[frozenset[str]], priors: Mapping[str, float]) -> float:
    """Bound P(some diagnosis ⊆ state) from below: each adds what those before it cannot have taken."""
    gains = []
    for index, blamed in enumerate(diagnoses):
        taken = fsum(_all_fail(earlier - blamed, priors) for earlier in diagnoses[:index])
        gains.append(_all_fail(blamed, priors) * max(0.0, 1.0 - taken))
    return fsum(gains)


def _exactly(
    diagnoses: Sequence[frozenset[str]], priors: Mapping[str, float], components: Collection[str]
) -> float:
    if any(component not in priors for component in components):
        return 0.0
    none = fsum(log1p(-priors[component]) for component in components)
    return fsum(exp(none + fsum(log_odds(priors[c]) for c in blamed)) for blamed in diagnoses)


def rank(
    result: DiagnosisResult, cnf: HealthCnf, options: Options, observed: Collection[Literal] = ()
) -> DiagnosisResult:
    """Return the result with probabilities and the unexplored mass, where the model has priors.

    `observed`: what was seen, for how well it fits each diagnosis; empty where that does not count.

    The order is kept, or is by probability if that was asked for.
    """
    if not cnf.priors:
        return result
    blamed = [diagnosis.bad for diagnosis in result.diagnoses]
    fits = likelihoods(cnf, observed, blamed) if observed and cnf.puts_out else None
    shares = posterior(blamed, cnf.priors, options.abnormal, fits)
    diagnoses = result.diagnoses
    if shares is not None:
        diagnoses = tuple(
            replace(diagnosis, probability=share) for diagnosis, share in zip(diagnoses, shares, strict=True)
        )
        if options.order == "probability":
            diagnoses = tuple(sorted(diagnoses, key=lambda diagnosis: -(diagnosis.probability or 0.0)))
    listed = result.complete and result.count in (None, len(diagnoses))
    if listed and options.minimal == "subset" and cnf.weak:
        unexplored: float | None = 0.0  # each state that OBS allows contains a diagnosis
    elif options.healthy or options.abnormal:
        unexplored = None  # the priors say nothing of a world that is only supposed
    else:
        unexplored = unexplored_mass(
            blamed,
            [conflict.components for conflict in result.conflicts],
            cnf.priors,
            weak=cnf.weak,
            components=cnf.components,
        )
    return replace(result, diagnoses=diagnoses, unexplored=unexplored)


def most_probable_first(
    result: DiagnosisResult, cnf: HealthCnf, observed: Collection[Literal]
) -> DiagnosisResult:
    """Return the result with the diagnoses of one size in the order in which robomend.planning.choice weighs
    them where nothing was tried: by probability, or, without priors, by how well OBS fits each.
    """
    diagnoses = result.diagnoses
    if len(diagnoses) < 2 or len(diagnoses) > WEIGHED:
        return result
    weights = [one.probability for one in diagnoses if one.probability is not None]
    if len(weights) < len(diagnoses):
        if not cnf.puts_out:
            return result
        weights = likelihoods(cnf, observed, [one.bad for one in diagnoses])
    order = sorted(
        range(len(diagnoses)), key=lambda index: (len(diagnoses[index].bad), -round(weights[index], 12))
    )
    return replace(result, diagnoses=tuple(diagnoses[index] for index in order))


def size_then_odds(cnf: HealthCnf) -> Callable[[int], float]:
    """Return what orders diagnoses, as masks, by size, and those of one size by the product of their odds.

    A component without a prior is taken to be as likely broken as not.
    """
    costs = [
        STEP - (log_odds(cnf.priors[component]) if component in cnf.priors else 0.0)
        for component in cnf.components
    ]

    def cost(mask: int) -> float:
        return fsum([costs[bit] for bit in bits(mask)])

    return cost


def odds_against(cnf: HealthCnf, suspects: int) -> Callable[[int], float]:
    """Return what orders diagnoses, as masks, by probability: the log odds of their members being healthy.

    Raises:
        OptionRefused: a suspect without a prior.
    """
    costs: dict[int, float] = {}
    for bit in bits(suspects):
        component = cnf.components[bit]
        if component not in cnf.priors:
            raise _without_prior(component)
        costs[bit] = -log_odds(cnf.priors[component])

    def cost(mask: int) -> float:
        return fsum([costs[bit] for bit in bits(mask)])

    return cost


def _without_prior(component: str) -> OptionRefused:
    return OptionRefused(f"order 'probability' needs a prior for each suspect, and {component} has none")


def by_probability(
    find_conflict: Callable[[int], int | None],
    components: Sequence[str],
    priors: Mapping[str, float],
    clock: Deadline,
) -> Iterator[int]:
    """Yield every minimal diagnosis as a bit mask, the most probable first.

    Implicit hitting sets whose costs are log odds of being healthy. A component that is more likely broken
    than not has a negative cost, which a hitting set cannot have: it counts as 0 there, and a diagnosis is
    held back until nothing that is still to come can be more probable. The same holds back what rounding
    could have put first.

    Args:
        find_conflict: takes the mask of the abnormal components; returns a conflict outside it, or None. A
            conflict of no component must be raised by it as its own error.
        components: COMPS; bit i is component i.
        priors: needed for each component that occurs in a conflict.
        clock: the deadline.

    Raises:
        OptionRefused: a suspect without a prior.
        OutOfTime: after yielding those that were held back.
    """
    check_priors(priors)
    exact = [-log_odds(priors[component]) if component in priors else inf for component in components]
    whole = [max(0, round(cost * SCALE)) if cost < inf else 0 for cost in exact]
    at_least = fsum(min(cost, 0.0) for cost in exact)
    sets = CheapestHittingSets(whole, clock)
    held: list[tuple[float, list[int], int]] = []
    suspects = 0
    try:
        while (candidate := sets.next()) is not None:
            rounding = 0.5 * suspects.bit_count() / SCALE
            bound = sets.cost / SCALE + at_least - rounding
            while held and held[0][0] <= bound:
                yield heappop(held)[2]
            conflict = find_conflict(candidate)
            if conflict is None:
                numbers = bits(candidate)
                heappush(held, (fsum(exact[bit] for bit in numbers), numbers, candidate))
                sets.block(candidate)
                continue
            for bit in bits(conflict & ~suspects):
                if exact[bit] == inf:
                    raise _without_prior(components[bit])
            suspects |= conflict
            sets.hit(conflict)
    except OutOfTime:
        while held:
            yield heappop(held)[2]
        raise
    finally:
        sets.close()
    while held:
        yield heappop(held)[2]
