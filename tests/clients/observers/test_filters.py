"""Filters, Student's t, slopes: against their definitions."""

from __future__ import annotations

import math
import statistics

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend_client.observers.filters import Filter
from robomend_client.observers.general import critical, significant
from robomend_client.observers.qualitative import REBUILD, Slope

SECOND = 1_000_000_000
numbers = st.floats(-1e6, 1e6)


@given(st.lists(numbers, min_size=1, max_size=50), st.integers(1, 8))
def test_mean_and_median_are_those_of_the_newest_window(values: list[float], size: int) -> None:
    mean = Filter(filter="mean", filter_window=size).make()
    median = Filter(filter="median", filter_window=size).make()
    for k, value in enumerate(values):
        window = values[max(0, k + 1 - size) : k + 1]
        assert mean.add(k, value) == pytest.approx(statistics.fmean(window), abs=1e-6)
        assert median.add(k, value) == statistics.median(window)
        assert mean.since_ns == median.since_ns == max(0, k + 1 - size)


@given(st.lists(numbers, min_size=1, max_size=50), st.floats(0.01, 1))
def test_ewma_is_the_recursion(values: list[float], decay: float) -> None:
    ewma = Filter(filter="ewma", filter_decay=decay).make()
    expected = values[0]
    for k, value in enumerate(values):
        expected = value if k == 0 else expected + decay * (value - expected)
        assert ewma.add(k, value) == pytest.approx(expected, abs=1e-6)


def test_a_filter_rests_on_the_samples_that_still_count_and_a_step_comes_through_in_as_many() -> None:
    for parameters in (Filter(), Filter("mean", 7), Filter("median", 7), Filter("ewma", filter_decay=0.3)):
        smooth = parameters.make()
        for k in range(100):
            smooth.add(k, 0.0)
        assert smooth.since_ns == 100 - parameters.samples
        value = 0.0
        for k in range(parameters.samples):
            value = smooth.add(100 + k, 1.0)
        assert value > 0.9
        smooth.reset()
        assert smooth.add(200, 5.0) == 5.0
        assert smooth.since_ns == 200


def test_a_running_mean_does_not_drift() -> None:
    mean = Filter(filter="mean", filter_window=3).make()
    for k in range(20_000):
        mean.add(k, 1e15 if k % 7 == 0 else 0.1)
    for k in range(20_000, 20_000 + 5000):
        value = mean.add(k, 0.1)
    assert value == pytest.approx(0.1, rel=1e-12)


# From the tables of the distribution: two-sided level, degrees of freedom, t.
TABLE = [
    (0.05, 1, 12.7062), (0.05, 2, 4.30265), (0.05, 3, 3.18245), (0.05, 4, 2.77645), (0.05, 9, 2.26216),
    (0.05, 30, 2.04227), (0.05, 100, 1.98397), (0.01, 3, 5.84091), (0.01, 9, 3.24984), (0.001, 4, 8.61030),
    (0.001, 9, 4.78091), (0.1, 9, 1.83311), (0.5, 3, 0.764892), (0.5, 9, 0.702722), (0.2, 1, 3.07768),
]  # fmt: skip


@pytest.mark.parametrize(("alpha", "df", "t"), TABLE)
def test_critical_values_are_those_of_the_tables(alpha: float, df: int, t: float) -> None:
    assert critical(alpha, df) == pytest.approx(t, rel=1e-5)


@given(st.lists(st.floats(-100, 100), min_size=2, max_size=20), st.floats(-100, 100))
def test_significance_is_the_definition(values: list[float], expected: float) -> None:
    n, mean, variance = len(values), statistics.fmean(values), statistics.variance(values)
    if variance < 1e-12:
        return
    t = abs(mean - expected) * math.sqrt(n) / math.sqrt(variance)
    limit = critical(0.05, n - 1)
    if abs(t - limit) > 1e-9 * limit:
        assert significant(mean - expected, variance, n, 0.05) is (t > limit)


def test_of_one_sample_nothing_is_known_and_on_a_perfect_clock_everything_is_significant() -> None:
    assert not significant(1.0, 0.0, 1, 0.05)
    assert significant(1e-12, 0.0, 2, 0.05)
    assert not significant(0.0, 0.0, 2, 0.05)


# --- slopes -----------------------------------------------------------------------------------------------


@given(
    st.lists(st.tuples(st.integers(1, 300), st.floats(-100, 100)), min_size=1, max_size=60),
    st.sampled_from([0, 10**18]),
    st.sampled_from([0.0, 1e6]),
)
def test_a_slope_is_that_of_the_least_squares_line(
    samples: list[tuple[int, float]], start_ns: int, offset: float
) -> None:
    slope, seen, time_ns = Slope(SECOND), list[tuple[float, float]](), start_ns
    for gap_ms, value in samples:
        time_ns += gap_ms * 1_000_000
        found = slope.add(time_ns, value + offset)
        seen.append(((time_ns - start_ns) / SECOND, value))
        window = [(t, v) for t, v in seen if seen[-1][0] - t < 1 - 1e-12]
        assert len(slope) == len(window)
        if len(window) < 3:
            assert found is None
        else:
            line = statistics.linear_regression(*zip(*window, strict=True))
            assert found == pytest.approx(line.slope, rel=1e-6, abs=1e-4)


def test_a_slope_does_not_drift_with_the_age_of_the_robot() -> None:
    slope = Slope(SECOND)
    for k in range(3 * REBUILD * 100 + 100):
        found = slope.add(10**18 + k * 10_000_000, 1e6 + 0.5 * k / 100)
    assert found == pytest.approx(0.5, rel=1e-6)
