"""The general observer against its definition, which looks at the whole history each time."""

from __future__ import annotations

from math import inf

from hypothesis import given
from hypothesis import strategies as st
from tests.clients.observers.driving import DEMO, verdict

from robomend_client.observers import SECOND, GeneralObserver, Rate, ns


def naive(rate: Rate, times_ns: list[int], now_ns: int) -> bool | None:
    """The definition for a full window, from the whole history each time: the newest run decides."""
    seen = [0, *times_ns]
    silence_ns = ns(rate.silence)
    if now_ns - seen[-1] >= silence_ns:
        return False
    starts = [i for i in range(1, len(seen)) if seen[i] - seen[i - 1] >= silence_ns]
    run = seen[starts[-1] :] if starts else seen[1:]
    if right(rate, run):
        return True
    unsaid = False if starts else None
    if len(run) < rate.messages:
        return unsaid
    if hertz(run[-rate.messages :]) >= rate.highest_hz and rate.held and len(run) < rate.messages + rate.held:
        return True if any(right(rate, run[:n]) for n in range(len(run))) else unsaid
    return False


def right(rate: Rate, run: list[int]) -> bool:
    """Whether the rate of the newest window is right, or too fast only because messages were held up."""
    if len(run) < rate.messages:
        return False
    f = hertz(run[-rate.messages :])
    if f < rate.highest_hz:
        return f > rate.lowest_hz
    longer = (run[-n:] for n in range(rate.messages + 1, min(len(run), rate.messages + rate.held) + 1))
    return any(hertz(times) < rate.highest_hz for times in longer)


def hertz(times_ns: list[int]) -> float:
    span_ns = times_ns[-1] - times_ns[0]
    return (len(times_ns) - 1) * SECOND / span_ns if span_ns else inf


rates = st.builds(
    lambda hz, tolerance, window, silence, held: Rate(
        rate_hz=hz,
        tolerance_hz=tolerance,
        window=window,
        settle=None,
        silence_s=max(silence, 1.01 / hz),
        held_s=held,
    ),
    st.sampled_from([1.0, 5.0, 10.0, 100.0]),
    st.sampled_from([0.1, 1.0, 4.0]),
    st.integers(2, 12),
    st.sampled_from([0.2, 0.5, 2.0]),
    st.sampled_from([None, 0.0, 0.3]),
)
# Mostly near 10 Hz, with bursts and gaps: uniform times would hardly ever be ok.
gaps = st.one_of(st.integers(95, 105), st.integers(0, 50), st.integers(0, 3000))


@given(rates, st.lists(gaps, max_size=60), st.integers(0, 2500))
def test_agrees_with_the_definition(rate: Rate, gaps_ms: list[int], later_ms: int) -> None:
    observer, times_ns, time_ms = GeneralObserver("scan", rate), [], 0
    for gap_ms in gaps_ms:
        time_ms += gap_ms
        times_ns.append(time_ms * 1_000_000)
        observer.feed("scan", times_ns[-1])
        expected = naive(rate, times_ns, times_ns[-1])
        assert verdict(observer, times_ns[-1] / SECOND) == expected
    now_ns = (times_ns[-1] if times_ns else 0) + later_ms * 1_000_000
    expected = naive(rate, times_ns, now_ns)
    assert [literal.positive for literal in observer.check(now_ns)] == [expected] * (expected is not None)


@given(st.lists(gaps, max_size=60), st.integers(-(10**9), 10**9))
def test_shifting_all_times_shifts_all_verdicts(gaps_ms: list[int], by_ms: int) -> None:
    first, second = GeneralObserver("scan", DEMO), GeneralObserver("scan", DEMO)
    first.reset(0)  # both: after a reset it is ok no sooner than silence could have been told
    second.reset(by_ms * 1_000_000)
    time_ms = 0
    for gap_ms in gaps_ms:
        time_ms += gap_ms
        first.feed("scan", time_ms * 1_000_000)
        second.feed("scan", (time_ms + by_ms) * 1_000_000)
        assert first.check(time_ms * 1_000_000) == second.check((time_ms + by_ms) * 1_000_000)
