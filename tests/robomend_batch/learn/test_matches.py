"""Values of two topics that go together."""

from __future__ import annotations

import numpy as np
import pytest

from robomend_batch.learn.gathering import Series
from robomend_batch.learn.matches import MatchFound, learn_matches
from robomend_batch.learn.stretches import Stretch
from robomend_client.observers import SECOND

NODES = {"odom": "/base", "imu": "/imu", "motor": "/motor"}
LENGTH_S = 600
TIMES = np.arange(0, LENGTH_S, 0.1)


def turning(seed: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return how fast a robot turns, which starts and stops."""
    chance = np.random.default_rng(seed)
    goals = np.repeat(chance.choice((-1.0, 0.0, 0.0, 1.0), len(TIMES) // 40 + 1), 40)[: len(TIMES)]
    return np.convolve(goals, np.full(10, 0.1), mode="same")


def series(values: object, noise: float = 0.01, seed: int = 0) -> Series:
    found = Series()
    noisy = np.asarray(values) + np.random.default_rng(seed).normal(0, noise, len(TIMES))
    for time, value in zip(TIMES.tolist(), noisy.tolist(), strict=True):
        found.add(0, round(time * SECOND), value)
    return found


def learn(**values: Series) -> list[MatchFound]:
    stretch = Stretch(0, 0, LENGTH_S * SECOND, False)
    named = {name.replace("__", ":"): one for name, one in values.items()}
    return learn_matches(named, NODES, [stretch])


@pytest.mark.parametrize("second", ["standing", "another", "opposite"])
def test_values_that_do_not_go_together_are_left_alone(second: str) -> None:
    turn = turning(1)
    other = {"standing": np.zeros(len(TIMES)), "another": turning(2), "opposite": -turn}[second]
    assert learn(odom__z=series(turn), imu__z=series(other, seed=1)) == []


def test_values_of_one_node_say_nothing_about_each_other() -> None:
    turn = turning(1)
    stretch = Stretch(0, 0, LENGTH_S * SECOND, False)
    values = {"odom:z": series(turn), "imu:z": series(turn, seed=1)}
    assert learn_matches(values, {"odom": "/base", "imu": "/base"}, [stretch]) == []
