"""Figures, picture and demo.json of a record, against one whose times are known."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.robomend_demo.records import restarted

from robomend.web.timeline import Span
from robomend_demo.figures import figures, percentile, union_ns
from robomend_demo.report import scenario_json, spans, timeline

INTERVALS = st.lists(st.tuples(st.integers(0, 60), st.integers(0, 60)), max_size=8)


def test_total_counts_from_the_fault_or_from_the_plan_until_a_client_knows_of_the_end() -> None:
    assert figures(restarted(), from_plan=False).total_s == pytest.approx(0.416)
    assert figures(restarted(), from_plan=True).total_s == pytest.approx(0.416 - 0.117)


def test_the_services_share_is_what_is_left_when_the_robots_time_is_taken_out() -> None:
    # From the observation at 100 to 416, less the robot's 130 … 400.
    assert figures(restarted(), from_plan=False).service_share_s == pytest.approx(0.316 - 0.270)


def test_a_diagnosis_is_timed_from_its_accepted_batch_to_its_arrival() -> None:
    assert figures(restarted(), from_plan=False).observation_to_diagnosis_ms == pytest.approx((3, 3, 3))


def test_the_plan_is_timed_from_the_diagnosis_it_rests_on() -> None:
    found = figures(restarted(), from_plan=False)
    assert found.detection_s == pytest.approx(0.108)
    assert found.diagnosis_to_plan_ms == pytest.approx(9)


def test_a_diagnosis_that_comes_while_the_plan_is_made_is_not_the_one_it_rests_on() -> None:
    found = figures(restarted(late=True), from_plan=False)
    assert found.detection_s == pytest.approx(0.108)
    assert found.diagnosis_to_plan_ms == pytest.approx(9)


@given(INTERVALS, st.integers(0, 60), st.integers(0, 60))
def test_the_union_of_intervals_is_what_counting_each_moment_gives(
    intervals: list[tuple[int, int]], begin: int, end: int
) -> None:
    covered = {moment for start, stop in intervals for moment in range(start, stop)}
    assert union_ns(intervals, begin, end) == len(covered & set(range(begin, end)))


@given(st.lists(st.integers(0, 9), min_size=1), st.integers(1, 100))
def test_a_percentile_is_the_least_value_that_so_many_do_not_exceed(values: list[int], percent: int) -> None:
    enough = [v for v in values if sum(other <= v for other in values) * 100 >= percent * len(values)]
    assert percentile(values, percent) == min(enough)


def test_demo_json_has_the_first_rounds_diagnosis_and_plan() -> None:
    record = restarted()
    told = scenario_json(record, figures(record, from_plan=False))
    assert told["diagnosis"] == {"bad": ["n"], "good": ["h"]}
    assert told["plan"] == ["start_node(n)"]
    assert "rounds" not in told
    assert told["account"] == ["12:00:00.000 repair x of r begins", "12:00:01.000 repaired"]
    assert [event["kind"] for event in told["events"]][:3] == ["observations", "diagnosis", "repair"]


def test_the_picture_shows_the_action_and_who_is_blamed_when() -> None:
    record = restarted()
    figure = timeline(record, ["h", "n"], figures(record, from_plan=False))
    (bar,) = figure.actions
    assert (bar.label, bar.start_s, bar.end_s, bar.ok) == ("start_node(n)", 0.12, 0.41, True)
    rows = dict(figure.rows)
    assert [span.state for span in rows["n"]] == ["good", "bad", "suspect", "good"]
    assert [span.state for span in rows["h"]] == ["good", "suspect", "good"]
    assert [mark.label for mark in figure.marks] == ["repair planned", "all good, verified", "diagnosis: {n}"]


def test_what_is_not_known_is_a_gap_and_equal_neighbours_are_one_span() -> None:
    told = [(1.0, (("a",),)), (2.0, (("a",), ("a", "b"))), (3.0, None), (4.0, ((),))]
    assert list(spans("a", told, 5.0, None)) == [Span(1.0, 3.0, True), Span(4.0, 5.0, False)]
    assert list(spans("b", told, 5.0, ((),))) == [
        Span(0.0, 2.0, False),
        Span(2.0, 3.0, True, only_suspect=True),
        Span(4.0, 5.0, False),
    ]
