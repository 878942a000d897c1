"""What is rarer than all that was seen."""

from __future__ import annotations

import numpy as np
import pytest

from robomend_batch.learn.tails import HEAVIEST, LIGHTEST, bound, largest_of_blocks, predicted, spread_above


def test_the_rarer_it_is_to_be_the_larger_it_is_by_a_power() -> None:
    samples = np.random.default_rng(1).exponential(1.0, 1000)
    values = [bound(samples, 1, rate).value - bound(samples, 1, rate).usual for rate in (1e-2, 1e-4)]
    assert 100**LIGHTEST <= values[1] / values[0] <= 100**HEAVIEST


@pytest.mark.parametrize("index", [0.25, 0.33, 0.5])
def test_of_a_pareto_tail_it_is_not_exceeded_more_often_than_asked_for(index: float) -> None:
    chance = np.random.default_rng(7)
    exceeded = 0
    for _ in range(40):
        seen = chance.pareto(1 / index, 2000)  # an hour
        value = bound(seen, hours=1, per_hour=0.1).value
        exceeded += int((chance.pareto(1 / index, 20_000) > value).sum())  # ten hours
    assert exceeded <= 60  # 40 were asked for


def test_samples_that_never_differ_have_their_value_as_the_bound() -> None:
    assert bound(np.full(50, 3.0), 1, 0.001).value == 3.0


def test_one_pause_counts_once() -> None:
    spans = np.ones(100)
    spans[40:50] = 5.0  # of all windows that hold it
    assert largest_of_blocks(spans, 10).tolist() == [1.0] * 4 + [5.0] + [1.0] * 5
    assert len(largest_of_blocks(np.zeros(0), 10)) == 0


@pytest.mark.parametrize("samples", [8, 20, 100])
def test_of_a_normal_sample_the_next_one_exceeds_a_prediction_as_often_as_was_said_or_less(
    samples: int,
) -> None:
    chance = np.random.default_rng(samples)
    exceeded = [
        chance.normal(5, 2) > predicted(chance.normal(5, 2, samples), samples, 0.01).value
        for _ in range(5000)
    ]
    assert np.mean(exceeded) < 0.015


def test_what_is_below_the_median_says_nothing_of_what_is_above() -> None:
    above = np.linspace(1.0, 1.1, 20)
    assert predicted(np.append(above, [0.0] * 19), 39, 1e-4).value < 1.6


def test_what_few_sums_do_not_tell_their_many_parts_tell_and_what_the_sums_show_is_the_least() -> None:
    chance = np.random.default_rng(5)
    exceeded, alone, together = [], [], []
    for _ in range(2000):
        parts = chance.normal(1.0, 0.1, 32)
        sums = parts.reshape(8, 4).sum(axis=1)
        found = predicted(sums, len(parts), 1e-3, 2 * spread_above(parts))
        exceeded.append(chance.normal(1.0, 0.1, 4).sum() > found.value)
        alone.append(predicted(sums, len(sums), 1e-3).value - 4)
        together.append(found.value - 4)
    assert np.mean(exceeded) < 3e-3
    assert np.median(together) < 0.6 * np.median(alone)
    drifts = np.repeat(chance.normal(1.0, 0.1, 8), 4)  # parts of a sum that are alike
    sums = drifts.reshape(8, 4).sum(axis=1)
    assert predicted(sums, 32, 1e-3, 2 * spread_above(drifts)).value >= predicted(sums, 32, 1e-3).value
