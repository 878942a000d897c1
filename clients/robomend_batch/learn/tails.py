"""How large something gets that is rarer than all that was seen.

    seen in H hours:   the largest excess over the usual value, X        once in H hours
    asked for:         what is exceeded r times an hour                  once in 1/r hours

                       X · (1 / (H r))^ξ        where the tail falls by a power

ξ is estimated by Hill from the largest excesses and kept from LIGHTEST to HEAVIEST: pauses of a computer come
in no shape that a fit of the ordinary ones would show, so that no tail is taken to be lighter than that of a
Pareto distribution of index 4. That errs to the side of few false alarms; what it costs is time until a fault
is told, and longer logs win it back.

Sources:
    B. Hill. A simple general approach to inference about the tail of a distribution. Ann. Stat. 3(5), 1975.
    I. Weissman. Estimation of parameters and large quantiles based on the k largest observations. JASA 73,
    1978.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robomend_client.observers.general import critical

LIGHTEST, HEAVIEST = 0.25, 0.5
"""Bounds of ξ."""

LEAST_ORDER, MOST_ORDER = 5, 100
"""How many of the largest a tail is estimated from."""

LIKELIEST = 0.01
"""Probability with which a prediction bound is exceeded, at most."""

Samples = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Bound:
    """What is exceeded as often as was asked for, and what that rests on."""

    value: float
    usual: float
    quantile: float  # 99.9 % of what was seen are below
    largest: float
    samples: int


def bound(
    samples: Samples,
    hours: float,
    per_hour: float,
    usual: float | None = None,
    heaviest: float = HEAVIEST,
) -> Bound:
    """Return what is exceeded `per_hour`.

    Args:
        samples: shape (n,), n > 0; as independent as they can be had, such as the largest of each block.
        hours: in which they were seen, > 0.
        per_hour: how often it may be exceeded, > 0.
        usual: what excesses are counted from; None: the median.
        heaviest: ξ is no larger; numbers that a sensor gives have lighter tails than times have.
    """
    middle = float(np.median(samples)) if usual is None else usual
    excess = np.sort(np.maximum(samples - middle, 0.0))[::-1]
    order = int(np.clip(len(excess) // 20, LEAST_ORDER, MOST_ORDER))
    order = min(order, len(excess))
    index = float(np.clip(_hill(excess[:order]), LIGHTEST, heaviest))
    rarer = 1 / (hours * per_hour)
    beyond = max(float(excess[k - 1]) * max(1.0, k * rarer) ** index for k in (1, order))
    return Bound(
        middle + beyond, middle, float(np.quantile(samples, 0.999)), float(samples.max()), len(samples)
    )


def predicted(samples: Samples, independent: int, probability: float, least_spread: float = 0.0) -> Bound:
    """Return what another sample exceeds with a probability: a prediction bound.

    Args:
        samples: shape (n,), n > 0; they may overlap.
        independent: how many values, of which none overlap, the spread was measured by.
        probability: above 0; no more than LIKELIEST is promised.
        least_spread: of parts of the samples, put together; no smaller one is believed.
    """
    middle, largest = float(np.median(samples)), float(samples.max())
    freedom = max(1, independent // 2)
    quantile = critical(2 * min(probability, LIKELIEST), freedom)  # of both sides together
    spread = max(spread_above(samples), least_spread)
    value = max(middle + quantile * spread * (1 + 1 / freedom) ** 0.5, largest)
    return Bound(value, middle, float(np.quantile(samples, 0.999)), largest, len(samples))


def spread_above(samples: Samples) -> float:
    """Return the standard deviation, as of a normal distribution whose upper half is above the median.

    What is below, such as windows in which what was held up comes at once, says nothing of what is above.
    """
    above = samples[samples > np.median(samples)] - np.median(samples)
    return float(np.sqrt(np.mean(above**2))) if len(above) else 0.0


def _hill(largest: Samples) -> float:
    """Return Hill's estimate of ξ from the largest excesses, in falling order."""
    floor = largest[-1]
    if floor <= 0 or len(largest) < LEAST_ORDER:
        return HEAVIEST if largest[0] > 0 else LIGHTEST
    return float(np.mean(np.log(largest[:-1] / floor)))


def largest_of_blocks(samples: Samples, size: int) -> Samples:
    """Return the largest of each block: what follows from one pause counts once."""
    if not len(samples):
        return samples
    return np.asarray(np.maximum.reduceat(samples, np.arange(0, len(samples), max(1, size))))
