"""How well a diagnosis fits what works: the likelihood of OBS, where the six schemes say nothing.

A weak fault model lets a broken component do anything, so ok(b) speaks neither for nor against a probe that
publishes b. People weigh it: what is broken seldom works. A component c that a diagnosis blames fails

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

from collections.abc import Collection, Iterable, Mapping
from math import prod

from robomend.model.cnf import HealthCnf, Output
from robomend.model.components import ComponentModel
from robomend.model.loops import Loop
from robomend_client.literals import Atom, Literal


def likelihood(cnf: HealthCnf, observed: Iterable[Literal], bad: Collection[str]) -> float:
    """Return P(OBS | this diagnosis) up to a factor that is the same for all; 1 where nothing is known of
    what components put out.
    """
    if not cnf.puts_out or not bad:
        return 1.0
    return _likelihood(cnf, {literal.atom: literal.positive for literal in observed}, bad)


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
    """Return the likelihood under each diagnosis."""
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
