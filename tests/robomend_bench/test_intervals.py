"""Confidence intervals, against published values and by coverage."""

from __future__ import annotations

import math
import random
from statistics import fmean

import pytest

from robomend_bench.intervals import bootstrap, poisson, quantile, wilson


@pytest.mark.parametrize(
    ("successes", "count", "low", "high"),
    [(0, 10, 0.0, 0.2775), (5, 10, 0.2366, 0.7634), (10, 10, 0.7225, 1.0), (81, 263, 0.2553, 0.3662)],
)
def test_wilson(successes: int, count: int, low: float, high: float) -> None:
    assert wilson(successes, count) == pytest.approx((low, high), abs=5e-5)


def test_of_nothing_nothing_is_known() -> None:
    assert wilson(0, 0) == (0.0, 1.0)
    assert all(math.isnan(bound) for bound in bootstrap([], fmean))
    assert math.isnan(quantile([], 0.5))


@pytest.mark.parametrize(("events", "low", "high"), [(0, 0.0, 3.69), (1, 0.025, 5.57), (10, 4.80, 18.39)])
def test_poisson_is_near_the_exact_interval(events: int, low: float, high: float) -> None:
    assert poisson(events) == pytest.approx((low, high), rel=0.02, abs=0.02)


def test_poisson_of_many_events() -> None:
    low, high = poisson(10_000)
    assert (low, high) == pytest.approx((9805, 10198), rel=0.001)


def test_the_bootstrap_covers_the_mean_about_as_often_as_it_says() -> None:
    chance = random.Random(1)
    covered = 0
    for _ in range(100):
        low, high = bootstrap([chance.random() for _ in range(40)], fmean)
        covered += low <= 0.5 <= high
    assert 87 <= covered <= 100


def test_quantiles_are_values_that_were_seen() -> None:
    assert [quantile([4.0, 1.0, 3.0, 2.0], share) for share in (0.5, 0.9, 1.0)] == [2.0, 4.0, 4.0]
