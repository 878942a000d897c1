"""Observers over streams in memory: how fast they are, when they tell of silence, how often without reason.

The samples go through the driver, as in the agent and over logs; time is that of the samples.
"""

from __future__ import annotations

import math
import random
import time
from collections.abc import Callable, Sequence

from robomend_client.observers import (
    SECOND,
    Driver,
    GeneralObserver,
    Observer,
    QualitativeObserver,
    Rate,
    Trend,
    ns,
)

HZ = 10.0
JITTER = 0.05
LOST = 0.001
PERIOD_NS = ns(1 / HZ)


def rate() -> GeneralObserver:
    """Return an observer of rate and silence that is asked each half second."""
    return GeneralObserver("scan", Rate(HZ, check_s=0.5))


def trend() -> QualitativeObserver:
    """Return an observer of a trend that gives a verdict with each sample."""
    return QualitativeObserver("x", "odom:x", Trend(check_s=0.0))


def samples_a_second(make: Callable[[], Observer], samples: int, repeats: int) -> list[float]:
    """Return the samples a second of processor time, of each repeat, one topic at 10 Hz of log time."""
    stream = [(k * PERIOD_NS, math.sin(k / 50)) for k in range(samples)]
    found = []
    for _ in range(repeats):
        observer = make()
        (source,) = observer.sources
        take = Driver([observer], 0).sample
        began = time.process_time()
        for time_ns, value in stream:
            take(source, time_ns, value)
        found.append(samples / (time.process_time() - began))
    return sorted(found)


def imperfect(messages: int, seed: int, lost: float = LOST) -> Sequence[int]:
    """Return the times of a topic with 5 % jitter of which a share of the messages is lost."""
    draw = random.Random(seed)
    times_ns = []
    time_s = 0.0
    for _ in range(messages):
        time_s += (1 + draw.uniform(-JITTER, JITTER)) / HZ
        if draw.random() >= lost:
            times_ns.append(ns(time_s))
    return times_ns


def alarms(messages: int, seed: int, lost: float, expected: Rate) -> int:
    """Return how often an observer called an imperfect topic not ok."""
    driver = Driver([GeneralObserver("scan", expected)], 0)
    changes = [c for time_ns in imperfect(messages, seed, lost) for c in driver.sample("scan", time_ns)]
    return sum(c.value is not None and not c.value.positive for c in changes)


def silences_s(count: int, seed: int) -> list[float]:
    """Return the times from the last message to `not ok`, default settings, sorted."""
    found = []
    for number in range(count):
        driver = Driver([GeneralObserver("scan", Rate(HZ))], 0)
        times_ns = imperfect(random.Random(number).randrange(50, 150), seed + number)
        for time_ns in times_ns:
            driver.sample("scan", time_ns)
        (silent,) = driver.advance(times_ns[-1] + 10 * SECOND)
        found.append((silent.time_ns - times_ns[-1]) / SECOND)
    return sorted(found)
