"""Costs of plans: equal, dearer within what is promised, and too dear."""

from __future__ import annotations

from dataclasses import replace

from robomend_bench.results import Run, Sample
from robomend_bench.tables import comparisons, too_dear

EXACT = Sample("g", 9, "q1", "exact", 0, "ok", 0.1, (), 3, cost=20.0, bound=1.0)
NEAR = replace(EXACT, contender="near", bound=1.1)


def test_equal_costs_are_fine() -> None:
    assert too_dear([EXACT, NEAR]) == ()


def test_a_contender_may_be_as_much_dearer_as_it_promises_and_no_more() -> None:
    assert too_dear([EXACT, replace(NEAR, cost=22.0)]) == ()
    (text,) = too_dear([EXACT, replace(NEAR, cost=23.0)])
    assert text.startswith("g/q1: 23 by near, 1.15× the cheapest known (20)")


def test_the_report_says_on_how_many_questions_costs_are_equal() -> None:
    other = [replace(EXACT, question="q2"), replace(NEAR, question="q2", cost=21.0)]
    unsolved = replace(EXACT, question="q3")
    samples = (EXACT, NEAR, *other, unsolved)
    run = Run("toy", "cost", "", 1, ("exact", "near", "absent"), {}, "", samples=samples)
    (text,) = comparisons(run)
    assert text.startswith("g: cost of exact and near equal on 1 of the 2 both solved")
    assert text.endswith("else 0.95× to 1.00× (together 40 and 41).")
