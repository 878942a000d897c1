"""Rates and silences of topics, judged by the observer that they are for."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from robomend_batch.learn.rates import HEAVIEST_PAUSES, WINDOWS, RateFound, learn_rate
from robomend_client.literals import fails
from robomend_client.observers import SECOND, Driver, GeneralObserver, Rate

Times = NDArray[np.int64]


def beats(hz: float, seconds: float, seed: int, pauses: tuple[tuple[float, float], ...] = ()) -> Times:
    """Return times with heavy-tailed jitter; what is due in a pause comes all at once after it."""
    chance = np.random.default_rng(seed)
    times = np.arange(0, seconds, 1 / hz) + 0.02 / hz * chance.standard_t(3, round(seconds * hz))
    for start, length in pauses:
        held = (times >= start) & (times < start + length)
        times[held] = start + length + 0.001 * np.arange(held.sum())
    return np.sort(np.maximum(times, 0) * SECOND).astype(np.int64)


def alarms(found: RateFound, times: Times) -> int:
    """Return how often the observer says that the topic is not ok."""
    rate = Rate(
        rate_hz=found.rate_hz,
        tolerance_hz=found.tolerance_hz,
        tolerance_above_hz=found.above_hz,
        window=found.window,
        settle=found.window - 1,
        silence_s=found.silence_s,
        pause_s=found.pause_s,
    )
    driver = Driver([GeneralObserver("scan", rate)], int(times[0]))
    changes = [change for time in times.tolist() for change in driver.sample("scan", time)]
    return sum(change.value == fails("ok", "scan") for change in changes)


def learned(times: Times, hours: float = 0.25) -> RateFound:
    found = learn_rate("scan", [times], hours, 0.01)
    assert isinstance(found, RateFound), found
    return found


def test_a_healthy_topic_with_pauses_that_were_never_seen_raises_no_alarm() -> None:
    found = learned(beats(10, 900, 1, ((100, 0.6),)))
    assert found.rate_hz == pytest.approx(10, rel=0.01)
    assert alarms(found, beats(10, 900, 2, ((200, 1.2), (500, 0.8)))) == 0


def test_what_silence_lets_pass_the_rate_lets_pass() -> None:
    found = learned(beats(10, 900, 1))
    length = 0.95 * found.silence_s
    assert alarms(found, beats(10, 600, 3, ((200, length),))) == 0


def stalled(seed: int) -> Times:
    """Return half a minute of 50 Hz; every few seconds it stalls, and what was due comes all at once."""
    chance = np.random.default_rng(seed)
    return beats(
        50, 30, seed, tuple((at + chance.random(), chance.uniform(0.2, 0.5)) for at in range(2, 30, 4))
    )


def test_half_a_minute_with_stalls_tells_that_half_of_the_messages_are_missing() -> None:
    found = learn_rate("scan", [stalled(1)], 30 / 3600, 1.0)
    assert isinstance(found, RateFound)
    assert not found.only_silence
    assert found.pause_s is not None
    for seed in range(2, 12):
        whole = stalled(seed)
        assert alarms(found, whole) == 0
        assert alarms(found, np.concatenate([whole[:750], whole[750::2]])) >= 1
        lossy = whole[750:][np.random.default_rng(seed).random(len(whole) - 750) < 0.5]
        assert alarms(found, np.concatenate([whole[:750], lossy])) >= 1


def uneven(seed: int, seconds: float) -> Times:
    """Return times at some 80 Hz, of which a few keep one waiting."""
    chance = np.random.default_rng(seed)
    count = round(80 * seconds)
    gaps = np.where(
        chance.random(count) < 0.03, chance.uniform(0.05, 0.12, count), chance.gamma(2, 0.005, count)
    )
    times = np.cumsum(gaps)
    return (times[times < seconds] * SECOND).astype(np.int64)


@pytest.mark.parametrize("seed", range(1, 6))
def test_a_quarter_of_a_minute_tells_that_half_of_the_messages_are_missing_at_one_false_alarm_in_ten_hours(
    seed: int,
) -> None:
    found = learn_rate("scan", [uneven(seed, 15)], 15 / 3600, 0.1)
    assert isinstance(found, RateFound)
    assert not found.only_silence
    whole = uneven(100 + seed, 120)
    assert alarms(found, whole) == 0
    assert alarms(found, np.concatenate([whole[:2000], whole[2000::2]])) >= 1


@pytest.mark.parametrize("seed", [1, 5, 6])
def test_a_log_that_holds_too_few_of_twice_the_window_is_learned_from_with_one_between(seed: int) -> None:
    found = learn_rate("scan", [uneven(seed, 7)], 7 / 3600, 0.1)
    assert isinstance(found, RateFound)
    assert not found.only_silence
    assert found.window not in WINDOWS
    whole = uneven(100 + seed, 120)
    assert alarms(found, whole) == 0
    assert alarms(found, np.concatenate([whole[:2000], whole[2000::2]])) >= 1


def test_silence_is_told_sooner_where_a_pause_was_seen_than_where_it_must_be_feared_like_any_other() -> None:
    def beyond(pause_s: float) -> float:
        gaps = learned(beats(10, 900, 1, ((100, pause_s),))).gaps
        return (gaps.value - gaps.usual) / (gaps.largest - gaps.usual)

    rarer = 1 / (0.25 * 0.01)
    assert beyond(3.0) <= 1.001 * rarer**HEAVIEST_PAUSES
    assert beyond(0.6) > 1.1 * rarer**HEAVIEST_PAUSES


def test_a_topic_that_comes_when_it_likes_is_not_watched() -> None:
    chance = np.random.default_rng(1)
    times = np.cumsum(chance.pareto(1.1, 500) * SECOND).astype(np.int64)
    found = learn_rate("cmd", [times], 0.5, 0.01)
    assert isinstance(found, str)
    assert found.startswith("irregular")


def test_a_few_messages_make_no_rate_nor_does_a_moment() -> None:
    burst = np.arange(0, 1_000_000, 1000, dtype=np.int64)
    assert learn_rate("scan", [burst], 0.1, 0.01) == "1000 messages within 0.000999 s: too short for a rate"
    assert learn_rate("map", [beats(10, 2, 1)], 0.1, 0.01) == "20 messages: too few for a rate"
    assert learn_rate("map", [], 0.1, 0.01) == "0 messages: too few for a rate"


def test_gaps_between_stretches_are_none_of_the_topic() -> None:
    times = beats(10, 900, 1)
    later = learn_rate("scan", [times[:4000], times[4000:] + 1000 * SECOND], 0.25, 0.01)
    assert isinstance(later, RateFound)
    assert later.gaps.largest < 1
