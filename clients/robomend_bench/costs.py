"""What plans cost, contender against contender: no answer is wrong, but one may be dearer than it promises.

An answer with a cost says by `bound` how many times the cost of the cheapest plan it may need. The cheapest
plan is the cheapest that any contender found for that question in that run: the proved optimum wherever an
optimal planner finished.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations

from robomend_bench.results import Run, Sample

TOLERANCE = 1e-6
"""Costs are sums of the actions' costs, in floating point."""

Costs = dict[tuple[str, str], dict[str, float]]
"""(group, question) -> contender -> the dearest plan of all repeats."""


def costs(samples: Iterable[Sample]) -> Costs:
    """Return the costs of all answers that have one."""
    found: Costs = {}
    for sample in samples:
        if sample.status == "ok" and sample.cost is not None:
            of_question = found.setdefault((sample.group, sample.question), {})
            of_question[sample.contender] = max(sample.cost, of_question.get(sample.contender, 0.0))
    return found


def too_dear(samples: Iterable[Sample]) -> tuple[str, ...]:
    """Return, in words, which plans cost more than their contender promises."""
    known = list(samples)
    bounds = {sample.contender: sample.bound for sample in known}
    texts = []
    for (group, question), by_contender in costs(known).items():
        cheapest = min(by_contender.values())
        for contender, cost in by_contender.items():
            if cost > bounds[contender] * cheapest + TOLERANCE:
                texts.append(
                    f"{group}/{question}: {cost:g} by {contender}, {_times(cost, cheapest)} the cheapest "
                    f"known ({cheapest:g}); at most {bounds[contender]:g}× is promised"
                )
    return tuple(texts)


def comparisons(run: Run) -> list[str]:
    """Return a sentence for each group and pair of contenders: on how many questions costs are equal."""
    by_question = costs(run.samples)
    texts = []
    for group in run.groups:
        for first, second in combinations(run.contenders, 2):
            pairs = [
                (by_contender[first], by_contender[second])
                for (of_group, _), by_contender in by_question.items()
                if of_group == group and {first, second} <= by_contender.keys()
            ]
            if not pairs:
                continue
            equal = sum(abs(ours - theirs) <= TOLERANCE for ours, theirs in pairs)
            text = f"{group}: cost of {first} and {second} equal on {equal} of the {len(pairs)} both solved"
            if equal < len(pairs):
                ratios = [ours / theirs for ours, theirs in pairs if theirs > 0]
                text += f", else {min(ratios):.2f}× to {max(ratios):.2f}×"
            texts.append(f"{text} (together {_sum(pairs, 0)} and {_sum(pairs, 1)}).")
    return texts


def _times(cost: float, cheapest: float) -> str:
    return f"{cost / cheapest:.2f}×" if cheapest else "not"


def _sum(pairs: list[tuple[float, float]], position: int) -> str:
    return f"{sum(pair[position] for pair in pairs):g}"
