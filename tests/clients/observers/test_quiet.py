"""Samples that are taken in at once leave a driver as if it had been fed with them one by one."""

from __future__ import annotations

import random
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from robomend_client.observers import Change, Driver
from robomend_client.observers.base import SECOND, Observer
from robomend_client.observers.filters import Filter
from robomend_client.observers.general import GeneralObserver
from robomend_client.observers.property import Band, PropertyObserver
from robomend_client.observers.rate import Rate
from robomend_client.observers.reading import Readings

Sample = tuple[str, int, float | None]
Changes = list[tuple[int, str, bool | None]]


def observers(chance: random.Random) -> Callable[[], list[Observer]]:
    """Return what makes observers of two topics, and of a value of a third."""
    rates = [
        Rate(
            hz,
            hz / 4,
            check_s=chance.choice((0.05, 0.5)),
            silence_s=chance.choice((None, 2.5 / hz)),
            pause_s=chance.choice((None, 1.5 / hz)),
        )
        for hz in (20.0, 7.0)
    ]
    readings = Readings(chance.choice((1, 3)), chance.choice((0.0, 0.2)), chance.choice((0.3, 5.0)))
    smoothing = Filter(chance.choice(("none", "none", "none", "median")))
    band = Band(low=-1.0, high=1.0, hysteresis=0.2)
    return lambda: [
        GeneralObserver("fast", rates[0]),
        GeneralObserver("slow", rates[1]),
        PropertyObserver("value", "speed:x", band, readings, smoothing),
    ]


def log(chance: random.Random) -> list[Sample]:
    """Return a log of a minute in which topics fall silent, slow down, and the value leaves its band."""
    found: list[Sample] = []
    for source, hz in (("fast", 20.0), ("slow", 7.0), ("speed:x", 10.0)):
        first = chance.randrange(97)
        lost = {first, first + 1}  # a pause, of which the rate stays right
        silent_s, slow_s, bad_s = (chance.uniform(10, 60) for _ in range(3))
        for number in range(int(60 * hz)):
            at_s = (number + chance.gauss(0, 0.02)) / hz
            if silent_s < at_s < silent_s + 3 or (slow_s < at_s < slow_s + 8 and number % 2):
                continue
            if number % 100 in lost or chance.random() < 0.002:
                continue
            odd = chance.random() < 0.001
            value = float("nan") if odd else 2.0 if bad_s < at_s < bad_s + 4 else chance.uniform(-0.9, 0.9)
            found.append((source, 100 * SECOND + int(at_s * SECOND), value if source == "speed:x" else None))
    return sorted(found, key=lambda sample: sample[1])


def said(changes: list[Change]) -> Changes:
    return [
        (one.time_ns, str(one.atom), None if one.value is None else one.value.positive) for one in changes
    ]


def one_by_one(driver: Driver, samples: list[Sample]) -> Changes:
    return said([change for source, at, value in samples for change in driver.sample(source, at, value)])


def at_once(driver: Driver, samples: list[Sample]) -> bool:
    arrays = {}
    for source in {source for source, _, _ in samples}:
        times = np.array([at for one, at, _ in samples if one == source], dtype=np.int64)
        values = np.array([value for one, _, value in samples if one == source], dtype=np.float64)
        arrays[source] = times, (lambda found=values: found) if source == "speed:x" else None
    moments = [driver.now_ns, *(at for _, at, _ in samples)]
    return driver.quiet(arrays, max(b - a for a, b in pairwise(moments)), moments[-1])


@pytest.mark.parametrize("seed", range(12))
def test_a_log_taken_in_by_stretches_says_what_it_says_sample_by_sample(seed: int) -> None:
    chance = random.Random(seed)
    make, samples = observers(chance), log(chance)
    slow, fast = (Driver(make(), samples[0][1]) for _ in range(2))
    expected = one_by_one(slow, samples) + said([*slow.advance(170 * SECOND)])
    found: Changes = []
    taken = begin = 0
    while begin < len(samples):
        end = begin + chance.randint(1, 60)
        if at_once(fast, samples[begin:end]):
            taken += 1
        else:
            found += one_by_one(fast, samples[begin:end])
        begin = end
    found += said([*fast.advance(170 * SECOND)])
    assert found == expected
    assert len(expected) > 5
    smoothed = make()[2]._remembered == 0  # type: ignore[attr-defined]  # a smoothed value counts one by one
    assert (taken > 5) is not smoothed
