"""A diagnosis in words, for a terminal: what leads, what all share, why, and what to look at next.

leading diagnoses  ─┐
what they share     ├─►  a screen of lines; the rest is counted, and `--all` or JSON has it
conflicts, probes  ─┘
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import fsum
from textwrap import wrap
from typing import TypeVar

from robomend.diagnosis.explanations import Cleared
from robomend.diagnosis.probes import Probe, ProbeResult
from robomend.diagnosis.result import Diagnosis, DiagnosisResult, Factor
from robomend_client.counts import counted, listed
from robomend_client.literals import quote

WIDTH = 80
LEADING = 5
"""Diagnoses that are shown; conflicts too."""

NAMED = 12
"""Components of one diagnosis that are named; a fleet's worth of them is counted."""

PROBES = 3

BOUNDS = {"limit": "--limit", "size": "--max-size", "time": "--timeout"}

NO_MODES: Mapping[str, str] = {}

Thing = TypeVar("Thing")


def leading_first(result: DiagnosisResult) -> DiagnosisResult:
    """Return the result with the most probable diagnosis first, where probabilities are known."""
    known = sorted(result.diagnoses, key=lambda diagnosis: -(diagnosis.probability or 0.0))
    cleared = Cleared([diagnosis.bad for diagnosis in known], result.conflicts)
    return replace(result, diagnoses=tuple(known), cleared=cleared)


def told(
    result: DiagnosisResult,
    probes: ProbeResult | None = None,
    *,
    everything: bool = False,
    repairable: bool = False,
    blind: bool = False,
) -> list[str]:
    """Return the lines of an answer.

    Args:
        result: the most probable first, see `leading_first`.
        probes: what to look at next; None: that was not asked.
        everything: leave nothing out.
        repairable: `robomend plan` can go on from here.
        blind: nothing was observed at all.
    """
    most = len(result.diagnoses) + len(result.conflicts) if everything else LEADING
    if blind and result.healthy:
        return ["healthy, for all we know: nothing was observed", "", _ending(result)]
    lines = [*_answer(result, most, everything), *_why(result, most, everything)]
    if not result.healthy and result.diagnoses:
        lines += _next(result, probes, repairable)
    return [*lines, "", _ending(result)]


def _answer(result: DiagnosisResult, most: int, everything: bool) -> Iterator[str]:
    if result.healthy:
        yield "healthy: this is what a system without fault would show"
    elif result.diagnoses:
        yield from _diagnoses(result, most, everything)
    elif result.complete:
        yield "no diagnosis: what is supposed cannot be, given what was seen"
    else:
        yield f"no diagnosis found: the search was stopped by {result.stopped_by}"


def _why(result: DiagnosisResult, most: int, everything: bool) -> Iterator[str]:
    if result.conflicts:
        yield ""
        yield "why"
        yield from _listed((conflict.text for conflict in result.conflicts), most, "conflicts")
    if not result.conflicts_complete:
        yield from wrap("not all that these diagnoses rest on: there was no time, or no room", WIDTH)
    if everything and result.cleared:
        yield ""
        yield from wrap(f"cleared, if it is {_names(result.diagnoses[0].bad)}", WIDTH)
        yield from _listed((f"{name}: {why}" for name, why in result.cleared.items()), len(result.cleared))


def _diagnoses(result: DiagnosisResult, most: int, everything: bool) -> Iterator[str]:
    diagnoses = result.diagnoses
    count = result.count or len(diagnoses)
    known = "" if result.complete or result.count else "at least "
    if count == 1:
        yield f"{known}1 diagnosis explains what was seen:"
    else:
        shared = _shared(result)
        those = "all" if result.complete or result.factored else "those found all"
        blamed = f"; {those} blame {_names(shared)}" if shared else ""
        yield from wrap(f"{known}{count} diagnoses, any one of which explains what was seen{blamed}:", WIDTH)
    yield ""
    if result.factored:
        yield from _products(result, most, everything)
        return
    shown = _cut(diagnoses, most)
    for diagnosis in shown:
        yield from _row(diagnosis, alone=len(diagnoses) == 1)
    if len(shown) < count:
        left = _together(diagnoses[len(shown) :]) if count == len(diagnoses) else None
        share = "" if left is None else f", {_percent(left)} together"
        yield f"  … and {count - len(shown)} more{share}"


def _row(diagnosis: Diagnosis, *, alone: bool) -> Iterator[str]:
    names = _names(diagnosis.bad, diagnosis.modes)
    share = "" if diagnosis.probability is None or alone else f"{_percent(diagnosis.probability):>6}  "
    yield from wrap(names, WIDTH, initial_indent=f"  {share}", subsequent_indent=" " * (len(share) + 2))


def _products(result: DiagnosisResult, most: int, everything: bool) -> Iterator[str]:
    """Yield the factored form: one diagnosis takes one choice of each brace."""
    shown = _cut(result.factored, most)
    named = len(result.components) if everything else NAMED
    for product in shown:
        factors = [_braces(factor, named) for factor in product[:named]]
        if len(product) > named:
            factors.append(counted(len(product) - named, "more factor"))
        text = " × ".join(factors)
        yield from wrap(text, WIDTH, initial_indent="  ", subsequent_indent="    ")
    if len(shown) < len(result.factored):
        yield f"  … and {counted(len(result.factored) - len(shown), 'more product')}"


def _braces(factor: Factor, named: int) -> str:
    """Return the choices of a factor: `{a, b + c}` is a, or b and c together."""
    choices = [" + ".join(map(quote, choice)) for choice in factor.choices[:named]]
    if len(factor.choices) > named:
        choices.append(f"{len(factor.choices) - named} more")
    return "{" + ", ".join(choices) + "}"


def _next(result: DiagnosisResult, probes: ProbeResult | None, repairable: bool) -> Iterator[str]:
    several = len(result.diagnoses) > 1
    if several and probes is not None:
        yield ""
        if probes.probes:
            yield "look next at"
            width = max(len(str(probe.atom)) for probe in probes.probes)
            for probe in probes.probes[:PROBES]:
                yield from _probe(probe, len(probes.diagnoses), len(result.diagnoses), width)
        elif probes.reason:
            yield from wrap(f"nothing to look at: {probes.reason}", WIDTH)
    if repairable:
        yield ""
        yield "what to do about it: robomend plan, with the same observations"


def _probe(probe: Probe, considered: int, known: int, width: int) -> Iterator[str]:
    true, false = considered - len(probe.if_false), considered - len(probe.if_true)
    diagnoses = f"{considered} diagnoses" if considered == known else f"the first {considered} diagnoses"
    cost = "" if probe.cost_s == 1 else f"; takes {probe.cost_s:g} s"
    left = f"{true} of {diagnoses} left if true, {false} if false{cost}"
    name = f"  {probe.atom!s:<{min(width, 30)}}  "
    yield from wrap(left, WIDTH, initial_indent=name, subsequent_indent=" " * 6)


def _listed(sentences: Iterable[str], most: int, what: str = "") -> Iterator[str]:
    every = list(sentences)
    shown = _cut(every, most)
    for sentence in shown:
        yield from wrap(sentence, WIDTH, initial_indent="  - ", subsequent_indent="    ")
    if len(shown) < len(every):
        yield f"  … and {len(every) - len(shown)} more {what}"


def _ending(result: DiagnosisResult) -> str:
    stopped = result.stopped_by
    if stopped == "limit" and result.factored and result.count is not None:
        return f"complete, as products; {result.elapsed_s * 1000:.1f} ms"
    ending = f"incomplete: stopped by {stopped} (see {BOUNDS[stopped]})" if stopped else "complete"
    if not result.smallest_proved and result.size_at_least:
        most = f", at most {result.size_at_most}" if result.size_at_most is not None else ""
        ending += f"; the smallest diagnosis has at least {counted(result.size_at_least, 'component')}{most}"
    return f"{ending}; {result.elapsed_s * 1000:.1f} ms"


def _cut(things: Sequence[Thing], most: int) -> Sequence[Thing]:
    """Return the first ones; all of them where the line that counts one more would take its place."""
    return things if len(things) <= most + 1 else things[:most]


def _shared(result: DiagnosisResult) -> tuple[str, ...]:
    if len(result.diagnoses) == 1 and not result.factored:
        return ()
    certain = result.certain
    return tuple(name for name in result.diagnoses[0].bad if name in certain)


def _names(names: Sequence[str], modes: Mapping[str, str] = NO_MODES) -> str:
    shown = [f"{quote(name)} ({modes[name]})" if name in modes else quote(name) for name in names[:NAMED]]
    if len(names) > NAMED:
        shown.append(f"{len(names) - NAMED} more")
    return listed(shown)


def _together(diagnoses: Sequence[Diagnosis]) -> float | None:
    shares = [diagnosis.probability for diagnosis in diagnoses]
    known = [share for share in shares if share is not None]
    return fsum(known) if len(known) == len(shares) else None


def _percent(share: float) -> str:
    return "< 0.1%" if share < 0.0005 else f"{100 * share:.1f}%"
