"""Waiting for a beat: all who wait are woken together, each about as often as it wants."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from robomend_client.beats import BEAT_NS, until_beat_s

PERIODS_S = st.sampled_from([0.01, 0.05, 0.1, 0.2, 0.3, 1.0, 2.5])


@given(st.integers(0, 2**61), PERIODS_S)
def test_a_wait_ends_on_a_beat_no_further_than_half_a_beat_from_its_period(
    now_ns: int, period_s: float
) -> None:
    wait_ns = round(until_beat_s(period_s, now_ns) * 1e9)
    assert (now_ns + wait_ns) % BEAT_NS == 0
    assert wait_ns > 0
    assert abs(wait_ns - period_s * 1e9) <= BEAT_NS / 2 or wait_ns <= BEAT_NS


@given(st.lists(st.integers(0, BEAT_NS - 1), min_size=2), PERIODS_S)
def test_who_is_woken_on_a_beat_and_has_done_its_work_waits_for_the_same_one(
    busy_ns: list[int], period_s: float
) -> None:
    short_ns = [ns // 3 for ns in busy_ns]
    assert len({ns + round(until_beat_s(period_s, ns) * 1e9) for ns in short_ns}) == 1
