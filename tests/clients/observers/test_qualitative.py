"""Trends, and whether two of them match."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend_client.observers import (
    BinaryQualitativeObserver,
    Change,
    Driver,
    Match,
    QualitativeObserver,
    Trend,
    ns,
)

YAW = "odom:yaw"
Signal = Callable[[float], float]


def word(o: QualitativeObserver, now_s: float) -> str | None:
    """Return the trend that is said; the other two are denied with it."""
    literals = o.check(ns(now_s))
    if not literals:
        return None
    (positive,) = [literal.atom.predicate for literal in literals if literal.positive]
    assert len(literals) == 3
    return positive


def run(signal: Signal, until_s: float, hz: float = 20, **trend: float) -> QualitativeObserver:
    o = QualitativeObserver("yaw", YAW, Trend(**trend))
    for k in range(int(until_s * hz) + 1):
        o.feed(YAW, ns(k / hz), signal(k / hz))
    return o


@pytest.mark.parametrize(("slope", "trend"), [(1.0, "inc"), (-1.0, "dec"), (0.04, "const"), (0.0, "const")])
def test_a_trend_is_the_slope_against_b(slope: float, trend: str) -> None:
    assert word(run(lambda t: 5 + slope * t, 2), 2) == trend


def test_a_line_needs_half_a_window_and_three_samples() -> None:
    assert word(run(lambda t: t, 0.45), 0.45) is None
    assert word(run(lambda t: t, 0.5), 0.5) == "inc"
    assert word(run(lambda t: t, 9, hz=1), 9) is None


def test_a_trend_holds_on_within_the_hysteresis() -> None:
    falling = [1.0, 0.045, 0.041, 0.039]
    o = QualitativeObserver("yaw", YAW, Trend(slope=0.05, hysteresis=0.2))
    value, said = 0.0, []
    for phase, slope in enumerate(falling):
        for k in range(40):
            value += slope / 20
            o.feed(YAW, ns(phase * 2 + k / 20), value)
        said.append(word(o, phase * 2 + 1.95))
    assert said == ["inc", "inc", "inc", "const"]
    assert word(run(lambda t: 0.045 * t, 2, slope=0.05, hysteresis=0.2), 2) == "const"


def test_a_new_trend_must_last_for_the_debounce() -> None:
    o = QualitativeObserver("yaw", YAW, Trend(debounce_s=0.5))
    turned = None
    for k in range(200):
        t = k / 20
        o.feed(YAW, ns(t), t if t < 5 else 10 - t)
        if turned is None and word(o, t) == "dec":
            turned = t
    plain = next(
        k / 20 for k in range(200) if word(run(lambda t: t if t < 5 else 10 - t, k / 20), k / 20) == "dec"
    )
    assert turned is not None
    assert plain + 0.45 <= turned <= plain + 0.55


def test_an_angle_that_wraps_around_goes_on() -> None:
    def wrapped(t: float) -> float:
        return (t + math.pi) % math.tau - math.pi

    said = set()
    o = QualitativeObserver("yaw", YAW, Trend(wraps_at=math.tau))
    for k in range(400):
        o.feed(YAW, ns(k / 20), wrapped(k / 20))
        said.add(word(o, k / 20))
    assert said == {None, "inc"}
    assert word(run(wrapped, 3.4), 3.4) == "dec"  # what the jump looks like otherwise


samples = st.lists(st.tuples(st.integers(0, 400), st.floats(-10, 10)), max_size=60)


@given(samples, st.integers(-(10**15), 10**15), st.integers(-1000, 1000))
def test_neither_when_nor_how_high_makes_a_difference(
    happened: list[tuple[int, float]], by_ns: int, up: int
) -> None:
    first, second, time_ns = QualitativeObserver("v", "v"), QualitativeObserver("v", "v"), 0
    for gap_ms, value in happened:
        time_ns += gap_ms * 1_000_000
        value = round(value)
        first.feed("v", time_ns, value)
        second.feed("v", time_ns + by_ns, value + up)
        assert first.check(time_ns) == second.check(time_ns + by_ns)


# --- two of them ------------------------------------------------------------------------------------------


def match(
    first: Signal, second: Signal, until_s: float, hz: float = 50, **parameters: object
) -> list[Change]:
    """Return what changes while both values are said."""
    o = BinaryQualitativeObserver("matched(a,b)", "a", "b", Match(**parameters))  # type: ignore[arg-type]  # several types
    driver = Driver([o], 0)
    changes: list[Change] = []
    for k in range(int(until_s * hz)):
        at_ns = ns((k + 0.5) / hz)
        changes += driver.sample("a", at_ns, first(k / hz))
        changes += driver.sample("b", at_ns, second(k / hz))
    return changes


def test_a_mismatch_is_told_after_the_threshold_and_forgotten_in_twice_the_time_at_most() -> None:
    def broken(t: float) -> float:
        return t if t < 10 or t > 30 else 10.0

    changes = match(lambda t: t, broken, 60, threshold=5)
    assert [str(c.value) for c in changes] == ["matched(a,b)", "not matched(a,b)", "matched(a,b)"]
    told_s, matched_s = changes[1].time_ns / 1e9, changes[2].time_ns / 1e9
    assert 11 < told_s < 12.5
    assert 30 < matched_s < 33
    assert changes[1].onset_ns is not None
    assert 10 <= changes[1].onset_ns / 1e9 < 11


def test_when_one_is_silent_for_a_window_the_match_is_unknown() -> None:
    o = BinaryQualitativeObserver("matched(a,b)", "a", "b")
    driver = Driver([o], 0)
    changes: list[Change] = []
    for k in range(500):
        at_ns = ns(k / 50 + 0.01)
        changes += driver.sample("a", at_ns, k / 50)
        if k < 250:
            changes += driver.sample("b", at_ns, k / 50)
    assert [str(c.value) for c in changes] == ["matched(a,b)", "None"]
    assert 6 <= changes[1].time_ns / 1e9 <= 6.4
    driver.advance(ns(100))
    assert driver.next_ns is None  # nobody says anything: nothing to tick for


def test_a_sign_can_be_compared_with_a_trend() -> None:
    """A commanded turning rate and the heading that results."""
    rate: Signal = lambda t: 1.0 if int(t / 5) % 2 else -1.0  # noqa: E731  # a signal of two lines

    def heading(t: float) -> float:
        phase = t % 10
        return -phase if phase < 5 else phase - 10

    (change,) = match(rate, heading, 40, compare="sign-trend", threshold=8)
    assert str(change.value) == "matched(a,b)"
    assert "not matched(a,b)" in [str(c.value) for c in match(rate, heading, 40, threshold=8)]


def test_a_match_rests_on_its_windows_and_on_nothing_before_a_reset() -> None:
    o = BinaryQualitativeObserver("matched(a,b)", "a", "b")
    driver = Driver([o], 0)
    for k in range(500):
        driver.sample("a", ns(k / 50), k / 50)
        driver.sample("b", ns(k / 50), k / 50)
    (verdict,) = driver.standing()
    assert 4.5 <= verdict.since_ns / 1e9 <= 4.8  # a window, and as many ticks as a mismatch takes
    o.reset(ns(10))
    assert o.check(ns(10)) == ()


@given(
    st.lists(st.tuples(st.booleans(), st.integers(0, 500), st.integers(-5, 5)), max_size=60),
    st.lists(st.integers(0, 20_000), max_size=20),
)
def test_how_often_it_is_asked_makes_no_difference(
    happened: list[tuple[bool, int, int]], asked_ms: list[int]
) -> None:
    often, seldom = (BinaryQualitativeObserver("matched(a,b)", "a", "b") for _ in range(2))
    time_ms, asks = 0, sorted(asked_ms)
    for first, gap_ms, value in happened:
        time_ms += gap_ms
        while asks and asks[0] <= time_ms:
            often.check(asks.pop(0) * 1_000_000)
        for o in (often, seldom):
            o.feed("a" if first else "b", time_ms * 1_000_000, value)
    now_ns = time_ms * 1_000_000
    assert often.check(now_ns) == seldom.check(now_ns)


# --- values that move in steps ----------------------------------------------------------------------------


@pytest.mark.parametrize("jitter_s", [0.0, 0.02])
@pytest.mark.parametrize("step_s", [1.0, 0.7, 2.5])
def test_a_value_that_moves_in_steps_rises_and_does_not_stand_in_turn(step_s: float, jitter_s: float) -> None:
    """Whole seconds of stamps, at 10 Hz, over the default window of a second."""
    rng = random.Random(1)
    driver = Driver([QualitativeObserver("stamp", "odom:stamp.sec")], 0)
    changes: list[Change] = []
    for k in range(450):
        at_s = k / 10 + 0.05 + rng.uniform(-jitter_s, jitter_s)
        changes += driver.sample("odom:stamp.sec", ns(at_s), int(at_s / step_s), ns(at_s))
    inc = [c.value.positive for c in changes if c.value is not None and c.atom.predicate == "inc"]
    assert inc == [True]
    # It stops: that is seen when it has stood for longer than two steps.
    stands = [
        change
        for k in range(450, 450 + round((2 * step_s + 1.5) * 10))
        for change in driver.sample("odom:stamp.sec", ns(k / 10), 1000, ns(k / 10))
    ]
    assert "const(stamp)" in [str(change.value) for change in stands]
    # And after a reset, too, its steps are known.
    driver.settle(1, driver.atoms)
    for k in range(600, 800):
        at_s = k / 10 + 0.05
        driver.sample("odom:stamp.sec", ns(at_s), int(at_s / step_s), ns(at_s))
    assert "inc(stamp)" in {str(verdict.literal) for verdict in driver.standing()}


@given(
    st.floats(0, 1),
    st.sampled_from([4, 5, 10, 20, 50]),
    st.sampled_from([1, 2]),
    st.lists(st.floats(0, 12), max_size=3),
)
def test_whole_seconds_never_stand_whenever_they_are_begun_to_be_watched_and_judged_anew(
    phase_s: float, hz: int, step_s: int, anew_s: list[float]
) -> None:
    observer = QualitativeObserver("stamp", "odom:stamp.sec")
    driver = Driver([observer], 0)
    said, asked_s, longest_s, asked = set(), 0.0, 0.0, sorted(anew_s)
    for k in range(20 * hz):
        t = k / hz
        changes = list(driver.sample("odom:stamp.sec", ns(t), int((t + phase_s) // step_s), ns(t)))
        if asked and asked[0] <= t:
            changes += driver.settle(k + 1, driver.atoms)
            asked, asked_s, longest_s = asked[1:], t, 0.0
        said |= {str(change.value) for change in changes}
        longest_s = max(longest_s, observer.settling_s)  # it is said anew with each poll
        assert observer.check(ns(t)) or t < asked_s + longest_s + 1 / hz + 0.02
    assert "const(stamp)" not in said
    assert "inc(stamp)" in said


def test_what_is_alike_for_the_first_moments_only_was_never_seen_to_match() -> None:
    """A driver that has just been started stands for a moment, as does what is stuck."""
    o = BinaryQualitativeObserver("matched(a,b)", "a", "b")
    o.reset(0)
    said = set()
    for number in range(int(12 / 0.05)):
        t = number * 0.05
        o.feed("a", ns(t), max(0.0, t - 1.5))
        o.feed("b", ns(t), 1.0)
        said |= set(map(str, o.check(ns(t))))
    assert said == {"not matched(a,b)"}
