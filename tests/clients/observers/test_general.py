"""The general observer: in sentences, and calm on an imperfect robot."""

from __future__ import annotations

import random
from dataclasses import replace
from itertools import pairwise

import pytest
from tests.clients.observers.driving import DEMO, SCAN, verdict

from robomend_client.literals import fails, holds
from robomend_client.observers import SECOND, Change, Driver, Evidence, GeneralObserver, Rate, ns


def fed(rate: Rate, *times_s: float) -> GeneralObserver:
    observer = GeneralObserver("scan", rate)
    for time_s in times_s:
        observer.feed("scan", ns(time_s))
    return observer


def beats(first_s: float, count: int, hz: float = 10.0) -> list[float]:
    return [first_s + number / hz for number in range(count)]


# --- the rate ---------------------------------------------------------------------------------------------


def test_parameters_that_are_not_given_follow_from_the_rate() -> None:
    assert (Rate(10).silence, Rate(2).silence, Rate(100).silence) == (0.35, 1.75, 0.35)
    assert (Rate(10, 1).messages, Rate(10, 2).messages, Rate(10, 5).messages) == (34, 16, 10)
    six = Rate(10, 2, lost=6)
    assert (six.silence, six.messages, Rate(40, lost=6).silence) == (0.65, 31, 0.35)


@pytest.mark.parametrize("lost", [1, 3, 7])
@pytest.mark.parametrize("tolerance_hz", [0.5, 1.0, 1.5, 3.0])
def test_so_many_messages_lost_in_a_full_window_are_within_the_tolerance(
    tolerance_hz: float, lost: int
) -> None:
    rate = Rate(10, tolerance_hz, lost=lost)
    times = beats(0, 3 * rate.messages)
    for number in range(lost):
        del times[-4 - 2 * number]
    assert verdict(fed(rate, *times), times[-1]) is True


@pytest.mark.parametrize("lost", [1, 3, 7])
def test_so_many_messages_lost_in_a_row_are_silence_and_one_less_is_none(lost: int) -> None:
    rate = Rate(4, lost=lost)
    for missing in (lost - 1, lost):
        times = beats(0, 3 * rate.messages, 4)
        del times[-2 - missing : -2]
        driver = Driver([GeneralObserver("scan", rate)], 0)
        changes = [change for time_s in times for change in driver.sample("scan", ns(time_s))]
        assert (fails("ok", "scan") in [change.value for change in changes]) is (missing == lost)


def test_a_pause_counts_as_so_long_at_most_and_half_of_the_messages_shows_beside_it() -> None:
    rate = Rate(rate_hz=10, tolerance_hz=3, window=11, settle=10, silence_s=2, pause_s=0.2)
    paused = [*beats(0, 11), *beats(2.5, 4)]
    assert verdict(fed(rate, *paused), paused[-1]) is True
    assert (
        verdict(fed(Rate(rate_hz=10, tolerance_hz=3, window=11, settle=10, silence_s=2), *paused), 2.8)
        is False
    )
    halved = [*beats(0, 11), *beats(2.5, 11, 5)]
    assert verdict(fed(rate, *halved), halved[-1]) is False
    assert verdict(fed(rate, *paused), paused[-1] + 2) is False  # silence is told as ever


def test_a_burst_may_be_faster_than_a_rate_may_be_slower() -> None:
    rate = Rate(rate_hz=10, tolerance_hz=1, tolerance_above_hz=10, window=11, settle=10, silence_s=0.5)
    assert verdict(fed(rate, *beats(0, 11, 19.5)), 0.6) is True
    assert verdict(fed(rate, *beats(0, 15, 20.5)), 0.8) is None  # the first five may have been held up
    assert verdict(fed(rate, *beats(0, 16, 20.5)), 0.8) is False
    assert verdict(fed(rate, *beats(0, 11, 9.2)), 1.2) is True
    assert verdict(fed(rate, *beats(0, 11, 8.8)), 1.2) is False
    assert verdict(fed(Rate(10, 1, window=11, silence_s=0.5), *beats(0, 16, 19.5)), 0.9) is False


@pytest.mark.parametrize("hz", [10.0, 40.0])
@pytest.mark.parametrize("tolerance", ["a fifth", "one hertz"])
def test_messages_that_were_held_up_and_come_at_once_are_not_too_many(hz: float, tolerance: str) -> None:
    rate = Rate(hz, hz / 5 if tolerance == "a fifth" else 1.0)
    times = beats(0, 2000, hz)
    begins_s, ends_s = times[1000], times[1000] + 0.6 * rate.silence
    # Those of this span come at its end, one a tenth of a millisecond after the other.
    times = [
        ends_s + 0.0001 * number if begins_s <= time_s < ends_s else time_s
        for number, time_s in enumerate(times, -1000)
    ]
    observer, strict = GeneralObserver("scan", rate), GeneralObserver("scan", replace(rate, held_s=0.0))
    found, by_its_window = set(), set()
    for time_s, after_s in pairwise(times):
        observer.feed("scan", ns(time_s))
        strict.feed("scan", ns(time_s))
        if after_s - time_s > 0.001:  # not in the middle of the burst
            found.add(verdict(observer, time_s))
            by_its_window.add(verdict(strict, time_s))
    assert found == {None, True}
    if hz > 10:  # else only one was held up
        assert by_its_window == {None, True, False}


def test_what_is_right_by_the_longer_window_rests_on_it() -> None:
    rate = Rate(rate_hz=10, tolerance_hz=1, window=11, settle=10, silence_s=0.5)
    observer = fed(rate, *beats(0, 21), 2.4, 2.4, 2.4, 2.4, *beats(2.5, 7))
    assert verdict(observer, 3.1) is True
    assert observer.evidence(SCAN, ns(3.1))[:2] == Evidence(ns(2.0))[:2]


def test_a_topic_is_unknown_until_it_settled_or_was_silent() -> None:
    observer = fed(DEMO)
    assert verdict(observer, 0.49) is None
    assert verdict(observer, 0.5) is False
    assert verdict(fed(DEMO, *beats(0, 5)), 0.41) is None


def test_half_a_second_of_silence_is_not_ok_and_the_rate_must_settle_again() -> None:
    observer = fed(DEMO, *beats(0, 20))
    assert verdict(observer, 2.39) is True
    assert verdict(observer, 2.4) is False
    for number, time_s in enumerate(beats(3, 6)):
        observer.feed("scan", ns(time_s))
        assert verdict(observer, time_s) is (number == 5)


@pytest.mark.parametrize(("hz", "ok"), [(8.9, False), (9.1, True), (10.9, True), (11.1, False)])
def test_the_rate_must_be_within_the_tolerance(hz: float, ok: bool) -> None:
    times = beats(0, 80, hz)
    assert verdict(fed(Rate(), *times), times[-1]) is ok


def test_a_message_lost_right_after_the_start_is_no_fault_and_half_the_rate_is() -> None:
    lost = beats(0, 10)
    del lost[3]
    observer = GeneralObserver("scan", Rate())
    seen = []
    for time_s in lost:
        observer.feed("scan", ns(time_s))
        seen.append(verdict(observer, time_s))
    assert False not in seen
    assert verdict(fed(Rate(), *beats(0, 10, hz=5)), 1.8) is False


def test_a_first_message_that_is_late_is_no_fault_and_twice_the_rate_is() -> None:
    observer = GeneralObserver("scan", Rate())
    seen = []
    for time_s in [0.09, *beats(0.1, 30)]:
        observer.feed("scan", ns(time_s))
        seen.append(verdict(observer, time_s))
    assert False not in seen
    assert seen[-1] is True
    assert verdict(fed(Rate(), *beats(0, 9, hz=20)), 0.4) is None
    assert verdict(fed(Rate(), *beats(0, 11, hz=20)), 0.5) is False


def test_what_waited_while_an_agent_began_is_no_rate_that_is_too_fast() -> None:
    observer = GeneralObserver("scan", Rate(10, 8, silence_s=3))
    seen = []
    for time_s in [*(1 + 0.0001 * number for number in range(10)), *beats(1.1, 40)]:
        observer.feed("scan", ns(time_s))
        seen.append(verdict(observer, time_s))
    assert False not in seen
    assert seen[-1] is True


def test_once_ok_a_message_lost_while_the_window_fills_leaves_it_ok() -> None:
    times = beats(0, 12)
    del times[8]
    observer = fed(Rate(), *times[:7])
    assert verdict(observer, times[6]) is True
    for time_s in times[7:]:
        observer.feed("scan", ns(time_s))
        assert verdict(observer, time_s) is True


def test_a_time_that_goes_far_back_begins_anew() -> None:
    observer = fed(DEMO, *beats(1000, 20), *beats(3, 6))
    assert verdict(observer, 3.5) is True
    assert verdict(observer, 4.1) is False


def test_after_one_stamp_from_the_future_it_judges_again_as_soon_as_from_the_start() -> None:
    observer = fed(DEMO, *beats(0, 20), 3600.0, *beats(2.0, 6))
    assert verdict(observer, 2.5) is True


def test_a_topic_that_was_never_heard_of_may_take_longer_to_come_up_but_only_the_first_time() -> None:
    rate = Rate(settle=5, silence_s=0.5, first_s=2)
    observer = GeneralObserver("scan", rate)
    observer.reset(ns(100))
    assert (verdict(observer, 101.9), verdict(observer, 102)) == (None, False)
    observer.reset(ns(101.8))  # judged anew: the robot boots no slower for that
    assert (verdict(observer, 102.2), verdict(observer, 102.3)) == (None, False)
    in_time = GeneralObserver("scan", rate)
    in_time.reset(ns(100))
    for time_s in beats(101.5, 6):
        in_time.feed("scan", ns(time_s))
    assert (verdict(in_time, 102.1), verdict(in_time, 102.5)) == (True, False)
    in_time.reset(ns(110))
    assert verdict(in_time, 110.5) is False
    late = GeneralObserver("scan", rate)
    late.reset(ns(100))
    late.feed("scan", ns(103))
    assert verdict(late, 103.1) is False


def test_a_t_test_forgives_what_may_be_chance_and_the_tolerance_what_is_of_no_matter() -> None:
    scattered = [0.0]
    for k in range(10):
        scattered.append(scattered[-1] + (0.07 if k % 2 else 0.155))
    exact = beats(0, 11, 8.89)
    strict = Rate(window=11, settle=10, silence_s=2)
    tested = Rate(window=11, settle=10, silence_s=2, test="student_t", significance=0.05)
    assert [verdict(fed(strict, *times), times[-1]) for times in (scattered, exact)] == [False, False]
    assert [verdict(fed(tested, *times), times[-1]) for times in (scattered, exact)] == [True, False]
    # On a good clock every bias is significant; within the tolerance it is of no matter.
    assert verdict(fed(tested, *beats(0, 11, 9.2)), 2) is True


# --- evidence ---------------------------------------------------------------------------------------------


def test_a_rate_rests_on_its_window() -> None:
    observer = fed(DEMO, *beats(0, 21))
    assert observer.evidence(SCAN, ns(2.05))[:2] == Evidence(ns(1.0))[:2]


def test_silence_rests_on_the_time_waited_for_and_began_with_the_last_message() -> None:
    observer = fed(DEMO, *beats(0, 21))
    assert observer.evidence(SCAN, ns(2.5))[:2] == Evidence(ns(2.0), ns(2.0))[:2]
    assert observer.evidence(SCAN, ns(9))[:2] == Evidence(ns(8.5), ns(2.0))[:2]


def test_while_the_rate_settles_the_verdict_rests_on_the_silence_before() -> None:
    observer = fed(DEMO, *beats(0, 21), 5.0, 5.1)
    assert verdict(observer, 5.15) is False
    assert observer.evidence(SCAN, ns(5.15))[:2] == Evidence(ns(4.5), ns(2.0))[:2]


def test_a_wrong_rate_began_with_the_last_message_at_which_it_was_right() -> None:
    observer, good_s = fed(DEMO, *beats(0, 21)), 0.0
    for time_s in beats(2.05, 100, 20):  # however long it lasts
        observer.feed("scan", ns(time_s))
        if verdict(observer, time_s):
            good_s = time_s
        else:
            assert observer.evidence(SCAN, ns(time_s)).onset_ns == ns(good_s)
    assert 2.0 < good_s < 2.5


def test_after_a_reset_nothing_older_counts() -> None:
    observer = fed(DEMO, *beats(0, 21))
    observer.reset(ns(2.05))
    assert verdict(observer, 2.4) is None
    assert verdict(observer, 2.55) is False
    assert observer.evidence(SCAN, ns(2.55))[:2] == Evidence(ns(2.05), None)[:2]


# --- calm -------------------------------------------------------------------------------------------------


def imperfect(messages: int, seed: int) -> list[int]:
    """Return the times of a 10 Hz topic with 5 % jitter of which one message in a thousand is lost."""
    draw = random.Random(seed)
    times_ns, time_s = [], 0.0
    for _ in range(messages):
        time_s += 0.1 * (1 + draw.uniform(-0.05, 0.05))
        if draw.random() >= 0.001:
            times_ns.append(ns(time_s))
    return times_ns


def test_an_imperfect_robot_raises_no_alarm_and_silence_is_told_within_half_a_second(long: bool) -> None:
    driver = Driver([GeneralObserver("scan")], 0)
    changes: list[Change] = []
    times_ns = imperfect(1_000_000 if long else 100_000, seed=12)
    for time_ns in times_ns:
        changes += driver.sample("scan", time_ns)
    assert [change.value for change in changes] == [holds("ok", "scan")]
    (silent,) = driver.advance(times_ns[-1] + SECOND)
    assert silent.value == fails("ok", "scan")
    assert silent.time_ns - times_ns[-1] < 0.4 * SECOND
