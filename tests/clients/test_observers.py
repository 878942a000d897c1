"""The observers, pure: against a naive oracle, and in sentences."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend_client.literals import fails, holds
from robomend_client.observers import PROCESSES, SECOND, GeneralObserver, NodeObserver, Rate, ns

DEMO = Rate(rate_hz=10, tolerance_hz=1, window=11, settle=5, silence_s=0.5, check_s=0.1)


def verdict(observer: GeneralObserver, now_s: float) -> bool | None:
    """Return the sign of the topic's literal, or None if it is unknown."""
    literals = observer.check(ns(now_s))
    return literals[0].positive if literals else None


def fed(rate: Rate, *times_s: float) -> GeneralObserver:
    observer = GeneralObserver("scan", rate, start_ns=0)
    for time_s in times_s:
        observer.feed("scan", ns(time_s))
    return observer


def beats(first_s: float, count: int, hz: float = 10.0) -> list[float]:
    return [first_s + number / hz for number in range(count)]


# --- the general observer -------------------------------------------------------------------------------


def test_the_defaults_are_the_published_ones() -> None:
    rate = Rate()
    assert (rate.rate_hz, rate.tolerance_hz, rate.window) == (10, 1, 10)
    assert (rate.silence_s, rate.check_s) == (2, 0.5)
    assert rate.intervals == 9


def test_a_topic_is_unknown_until_it_settled_or_was_silent() -> None:
    observer = fed(DEMO)
    assert verdict(observer, 0.49) is None
    assert verdict(observer, 0.5) is False
    assert verdict(fed(DEMO, *beats(0, 5)), 0.41) is None


def test_five_intervals_at_the_right_rate_are_ok() -> None:
    assert verdict(fed(DEMO, *beats(0, 6)), 0.51) is True


def test_half_a_second_of_silence_is_not_ok_and_the_rate_must_settle_again() -> None:
    observer = fed(DEMO, *beats(0, 20))
    assert verdict(observer, 2.39) is True
    assert verdict(observer, 2.4) is False
    for number, time_s in enumerate(beats(3, 6)):
        observer.feed("scan", ns(time_s))
        assert verdict(observer, time_s) is (number == 5)


@pytest.mark.parametrize(("hz", "ok"), [(8.9, False), (9.1, True), (10.9, True), (11.1, False), (50, False)])
def test_the_rate_must_be_within_the_tolerance(hz: float, ok: bool) -> None:
    times = beats(0, 30, hz)
    assert verdict(fed(DEMO, *times), times[-1]) is ok


def test_the_rate_is_that_of_the_newest_window_only() -> None:
    three = Rate(rate_hz=10, tolerance_hz=1, window=3)
    assert verdict(fed(three, 0, 0.2, 0.4, 0.5), 0.55) is False
    assert verdict(fed(three, 0, 0.2, 0.4, 0.5, 0.6), 0.65) is True


def test_messages_all_at_one_time_are_not_the_right_rate() -> None:
    assert verdict(fed(DEMO, *([1.0] * 20)), 1.0) is False


def test_a_time_that_goes_back_counts_as_the_newest() -> None:
    forward, back = fed(DEMO, 0.1, 0.2, 0.2, 0.3), fed(DEMO, 0.1, 0.2, 0.15, 0.3)
    assert forward.check(ns(0.35)) == back.check(ns(0.35))


def test_the_literal_names_the_topic() -> None:
    assert fed(DEMO).check(ns(1)) == (fails("ok", "scan"),)
    assert fed(DEMO, *beats(0, 6)).check(ns(0.5)) == (holds("ok", "scan"),)


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"rate_hz": 0.0}, "rate_hz"),
        ({"window": 1}, "window"),
        ({"settle": 10}, "settle"),
        ({"silence_s": 0.1}, "silence_s"),
        ({"check_s": -1.0}, "check_s"),
    ],
)
def test_impossible_parameters_are_refused_by_name(wrong: dict[str, float], named: str) -> None:
    with pytest.raises(ValueError, match=named):
        Rate(**wrong)  # type: ignore[arg-type]  # ints and floats in one table


def naive(rate: Rate, times_ns: list[int], now_ns: int) -> bool | None:
    """The definition, from the whole history each time: the newest run without silence decides."""
    seen, newest = [0], 0
    for time_ns in times_ns:
        newest = max(newest, time_ns)
        seen.append(newest)
    silence_ns = ns(rate.silence_s)
    if now_ns - seen[-1] >= silence_ns:
        return False
    starts = [i for i in range(1, len(seen)) if seen[i] - seen[i - 1] >= silence_ns]
    run = seen[starts[-1] :] if starts else seen[1:]
    if len(run) - 1 < rate.intervals:
        return False if starts else None
    window = run[-rate.window :]
    span_ns = window[-1] - window[0]
    if span_ns == 0:
        return False
    return abs((len(window) - 1) * SECOND / span_ns - rate.rate_hz) < rate.tolerance_hz


rates = st.builds(
    lambda hz, tolerance, window, settle, silence: Rate(
        rate_hz=hz,
        tolerance_hz=tolerance,
        window=window,
        settle=min(settle, window - 1) if settle else None,
        silence_s=max(silence, 1.01 / hz),
    ),
    st.sampled_from([1.0, 5.0, 10.0, 100.0]),
    st.sampled_from([0.1, 1.0, 4.0]),
    st.integers(2, 12),
    st.none() | st.integers(1, 11),
    st.sampled_from([0.2, 0.5, 2.0]),
)
# Mostly near 10 Hz, with bursts, gaps and times that go back: uniform times would hardly ever be ok.
gaps = st.one_of(st.integers(95, 105), st.integers(-50, 50), st.integers(0, 3000))


@given(rates, st.lists(gaps, max_size=60), st.integers(0, 2500))
def test_agrees_with_the_definition(rate: Rate, gaps_ms: list[int], later_ms: int) -> None:
    observer, times_ns, time_ms = GeneralObserver("scan", rate, start_ns=0), [], 0
    for gap_ms in gaps_ms:
        time_ms = max(0, time_ms + gap_ms)
        times_ns.append(time_ms * 1_000_000)
        observer.feed("scan", times_ns[-1])
        now_ns = max(times_ns)
        expected = naive(rate, times_ns, now_ns)
        assert [literal.positive for literal in observer.check(now_ns)] == [expected] * (expected is not None)
    now_ns = max(times_ns, default=0) + later_ms * 1_000_000
    expected = naive(rate, times_ns, now_ns)
    assert [literal.positive for literal in observer.check(now_ns)] == [expected] * (expected is not None)


# --- the node observer -----------------------------------------------------------------------------------


def test_nodes_are_unknown_before_the_first_look() -> None:
    assert NodeObserver(["a"]).check(0) == ()


def test_each_watched_node_runs_or_does_not() -> None:
    observer = NodeObserver(["jaguar_node", "hokuyo_node"])
    observer.feed(PROCESSES, 0, {"jaguar_node", "somebody_else"})
    assert observer.check(1) == (fails("running", "hokuyo_node"), holds("running", "jaguar_node"))


def test_names_that_are_no_collection_are_refused() -> None:
    with pytest.raises(TypeError, match="collection"):
        NodeObserver(["a"]).feed(PROCESSES, 0, "a")
