"""Our own counters and histograms say what prometheus_client's would."""

from __future__ import annotations

import re

from hypothesis import given
from hypothesis import strategies as st
from prometheus_client import CollectorRegistry, Counter, Histogram, generate_latest

from robomend.metrics import FINE_S
from robomend.tallies import Spreads, Tallies

LABELS = st.sampled_from(["a", "b", 'with "quotes"\n'])
VALUES = st.one_of(st.sampled_from(FINE_S), st.floats(0, 100), st.just(float("inf")))


def shown(registry: CollectorRegistry) -> str:
    """Return the text for Prometheus, without when each child was made, which ours do not say."""
    text = generate_latest(registry).decode()
    return re.sub(r"^(# (HELP|TYPE) )?\w+_created.*\n", "", text, flags=re.MULTILINE)


@given(st.lists(st.tuples(LABELS, st.integers(0, 5))), st.lists(st.tuples(LABELS, VALUES)), st.lists(VALUES))
def test_they_are_shown_as_prometheus_shows_its_own(
    counted: list[tuple[str, int]], observed: list[tuple[str, float]], unlabelled: list[float]
) -> None:
    ours, theirs = CollectorRegistry(), CollectorRegistry()
    tallies, spreads = Tallies("n", "of", ("x",)), Spreads("s", "took", ("x",), bounds=FINE_S)
    alone = Spreads("alone", "took", bounds=FINE_S)
    for each in (tallies, spreads, alone):
        ours.register(each)
    counter = Counter("n", "of", ("x",), registry=theirs)
    histogram = Histogram("s", "took", ("x",), buckets=FINE_S, registry=theirs)
    single = Histogram("alone", "took", buckets=FINE_S, registry=theirs)
    for label, by in counted:
        tallies.labels(label).inc(by)
        counter.labels(label).inc(by)
    for label, value in observed:
        spreads.labels(label).observe(value)
        histogram.labels(label).observe(value)
    for value in unlabelled:
        alone.labels().observe(value)
        single.observe(value)
    assert shown(ours) == shown(theirs)
