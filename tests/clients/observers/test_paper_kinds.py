"""What holds of the eight observers of the paper under the driver, whatever is fed to them, in any order."""

from __future__ import annotations

import math
from collections.abc import Iterable

from hypothesis import given, settings
from hypothesis import strategies as st

from robomend_client.observers import (
    SECOND,
    Answers,
    Band,
    BinaryQualitativeObserver,
    Change,
    DiagnosticObserver,
    Driver,
    GeneralObserver,
    HardwareObserver,
    MultipleObserver,
    NodeObserver,
    Observer,
    PropertyObserver,
    QualitativeObserver,
    Readings,
    Table,
    Wiring,
    ns,
)

MS = 1_000_000
START_NS = 1000 * SECOND

Sample = tuple[str, int, object]
"""Source, when it was made, value; its place is its place in the list."""


def eight() -> list[Observer]:
    return [
        GeneralObserver("scan"),
        NodeObserver(["n"], Table(lifetime_s=1)),
        DiagnosticObserver("driver", ["driver*"], ["hot < 60"], readings=Readings(lifetime_s=2)),
        MultipleObserver("ok(answer_triggered)", "ask", "answer", Answers()),
        QualitativeObserver("x", "odom:x"),
        BinaryQualitativeObserver("matched(x,y)", "odom:x", "imu:y"),
        HardwareObserver({"motor": Wiring(0, 1.0)}),
        PropertyObserver("warm", "odom:x", Band(high=5.0)),
    ]


numbers = st.floats(-10, 10)
channels = st.tuples(st.booleans(), st.sampled_from([0.0, 1.0, 9.0])).map(
    lambda one: [{"on": one[0], "current_a": one[1]}]
)
statuses = st.builds(
    lambda level, hot: [{"name": "driver: x", "level": level, "values": {"hot": hot}}],
    st.integers(0, 3),
    st.sampled_from(["20", "80", "?"]),
)
values = st.one_of(
    st.tuples(st.just("scan"), st.none()),
    st.tuples(st.just("scan"), st.none()),
    st.tuples(st.just("processes"), st.sampled_from([["n"], [], ["n", "m"]])),
    st.tuples(st.just("diagnostics"), statuses),
    st.tuples(st.sampled_from(["ask", "answer"]), st.none()),
    st.tuples(st.sampled_from(["odom:x", "imu:y"]), numbers),
    st.tuples(st.just("board"), st.one_of(st.none(), channels)),
)
gaps_ms = st.one_of(st.integers(0, 60), st.integers(0, 60), st.integers(0, 4000))
happened = st.lists(st.tuples(values, gaps_ms), max_size=60)


def stream(told: Iterable[tuple[tuple[str, object], int]]) -> list[tuple[int, Sample]]:
    """Return samples with the times at which they are taken in."""
    found, now_ns = [], START_NS
    for (source, value), gap_ms in told:
        now_ns += gap_ms * MS
        found.append((now_ns, (source, now_ns, value)))
    return found


def run(
    taken: Iterable[tuple[int, Sample]], observers: list[Observer] | None = None, shift_ns: int = 0
) -> list[Change]:
    """Return what changes, until 20 s after the last sample."""
    driver = Driver(eight() if observers is None else observers, START_NS + shift_ns)
    changes: list[Change] = []
    for now_ns, (source, time_ns, value) in taken:
        changes += driver.sample(source, time_ns + shift_ns, value, now_ns + shift_ns)
    changes += driver.advance(driver.now_ns + 20 * SECOND)
    assert not [what for what, _ in driver.problems.counts if what not in ("ahead", "number")]
    assert {change.atom for change in changes} <= set(driver.atoms)
    assert [change.time_ns for change in changes] == sorted(change.time_ns for change in changes)
    assert all(change.since_ns is None or change.since_ns <= change.time_ns for change in changes)
    return changes


def later(change: Change, by_ns: int) -> Change:
    since_ns = None if change.since_ns is None else change.since_ns + by_ns
    onset_ns = None if change.onset_ns is None else change.onset_ns + by_ns
    return change._replace(time_ns=change.time_ns + by_ns, since_ns=since_ns, onset_ns=onset_ns)


@settings(max_examples=50)
@given(happened, st.integers(-900, 10**6))
def test_when_it_happens_makes_no_difference(told: list[tuple[tuple[str, object], int]], by_s: int) -> None:
    samples, by_ns = stream(told), by_s * SECOND  # a whole number of every period there is
    assert run(samples, shift_ns=by_ns) == [later(change, by_ns) for change in run(samples)]


@settings(max_examples=50)
@given(happened, st.lists(st.integers(0, 5000), max_size=60))
def test_samples_of_one_source_that_overtake_each_other_count_as_simultaneous(
    told: list[tuple[tuple[str, object], int]], behind_ms: list[int]
) -> None:
    overtaken, in_order, newest_ns = [], [], dict.fromkeys(("",), 0)
    behind_ms = behind_ms + [0] * len(told)
    for (now_ns, (source, made_ns, value)), ms in zip(stream(told), behind_ms, strict=False):
        made_ns -= ms * MS
        newest_ns[source] = max(made_ns, newest_ns.get(source, 0))
        overtaken.append((now_ns, (source, made_ns, value)))
        in_order.append((now_ns, (source, newest_ns[source], value)))
    assert run(overtaken) == run(in_order)


@settings(max_examples=50)
@given(happened, st.lists(st.tuples(values, st.integers(0, 60), st.integers(1001, 10**7)), max_size=5))
def test_stamps_from_the_future_and_numbers_that_are_none_change_nothing(
    told: list[tuple[tuple[str, object], int]], odd: list[tuple[tuple[str, object], int, int]]
) -> None:
    samples = stream(told)
    disturbed = list(samples)
    for (source, value), place, ahead_ms in odd:
        at = min(place, len(disturbed))
        now_ns = disturbed[at - 1][0] if at else START_NS
        disturbed.insert(at, (now_ns, (source, now_ns + ahead_ms * MS, value)))
        for number_of in ("odom:x", "imu:y"):
            disturbed.insert(at, (now_ns, (number_of, now_ns, math.nan)))
    assert run(disturbed) == run(samples)


@settings(max_examples=50)
@given(happened)
def test_a_sample_that_comes_twice_says_nothing_more_of_what_is(
    told: list[tuple[tuple[str, object], int]],
) -> None:
    """Of the rate of a topic, and of how many readings agree, it does."""
    samples = stream(told)
    twice = [one for one in samples for _ in range(2)]
    kinds = (NodeObserver, DiagnosticObserver, MultipleObserver, PropertyObserver)
    once, again = (
        run(taken, [one for one in eight() if isinstance(one, kinds)]) for taken in (samples, twice)
    )
    assert again == once
    run(twice)


@settings(max_examples=50)
@given(happened)
def test_after_a_gap_nothing_that_was_seen_before_it_is_still_said(
    told: list[tuple[tuple[str, object], int]],
) -> None:
    driver = Driver(eight(), START_NS)
    for now_ns, (source, time_ns, value) in stream(told):
        driver.sample(source, time_ns, value, now_ns)
    driver.advance(driver.now_ns + 60 * SECOND)
    since_ns = {str(verdict.literal): verdict.since_ns for verdict in driver.standing()}
    # A topic is silent, by now; a question that was never answered has not been until now.
    assert since_ns.keys() <= {"not ok(scan)", "not ok(answer_triggered)"}
    assert driver.now_ns - since_ns.get("not ok(scan)", driver.now_ns) <= ns(1)
