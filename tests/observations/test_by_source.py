"""Several sources of one atom: who counts, and when they contradict each other, in any order of arrival."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend.entry import Entry
from robomend.observations.obs import MAX_SOURCES, Belief, Obs, until_ns
from robomend_client.literals import Atom, Literal

SCAN = Atom("ok", ("scan",))
S = 10**9


def said(
    source: str,
    holds: bool,
    at_s: float,
    since_s: float | None = None,
    onset_s: float | None = None,
    lifetime_s: float | None = 5,
) -> Entry:
    """Return a report, by default with evidence of the moment and a lifetime."""

    def ns(time_s: float) -> int:
        return round(time_s * S)

    since_s = at_s if since_s is None else since_s
    expires_ns = None if lifetime_s is None else ns(at_s + lifetime_s)
    onset_ns = None if onset_s is None else ns(onset_s)
    return Entry(Literal(SCAN, holds), source, ns(at_s), expires_ns, ns(since_s), onset_ns)


def after(*reports: Entry, belief: Belief | None = None) -> Obs:
    obs = Obs(belief=belief or Belief())
    for report in reports:
        obs.update([report])
    return obs


def known(obs: Obs, at_s: float) -> bool | None:
    return obs.known(SCAN, round(at_s * S))


def names(obs: Obs, at_s: float) -> list[tuple[list[str], list[str], str | None]]:
    """Return who contradicts whom, and who is believed."""
    return [
        (
            sorted(entry.source for entry in one.holds),
            sorted(entry.source for entry in one.fails),
            None if one.believed is None else one.believed.source,
        )
        for one in obs.contradictions(round(at_s * S))
    ]


A_HEARS = [said("a", True, at, at - 0.5, 0) for at in (2, 4, 6, 8)]
B_DOES_NOT = [said("b", False, at, at - 0.5, 3) for at in (3.5, 5.5, 7.5)]
B_DID = said("b", True, 1.5, 1, 0)
BOTH = sorted([B_DID, *A_HEARS, *B_DOES_NOT], key=lambda entry: entry.time_ns)


def test_what_one_computer_hears_and_another_does_not_is_unknown_and_told() -> None:
    obs = Obs()
    values = []
    for report in BOTH:
        obs.update([report])
        values.append(obs.known(SCAN, report.time_ns))
    # a hears it; then b's silence is news; a stands by its own, with evidence from after b's onset.
    assert values == [True, True, False, None, None, None, None, None]
    assert names(obs, 8.1) == [(["a"], ["b"], None)]
    assert obs.literals(8 * S) == ()


@pytest.mark.parametrize(
    ("belief", "value", "who"),
    [
        (Belief(("b", "a")), False, "b"),
        (Belief(("c", "a", "b")), True, "a"),
        (Belief(("c",)), None, None),
        (Belief(("c",), bad_wins=True), False, "b"),
        (Belief(("a",), bad_wins=True), True, "a"),
    ],
)
def test_the_robots_configuration_says_who_is_believed(
    belief: Belief, value: bool | None, who: str | None
) -> None:
    obs = after(*BOTH, belief=belief)
    assert known(obs, 8.1) is value
    assert names(obs, 8.1) == [(["a"], ["b"], who)]  # it is a finding all the same


def test_a_person_overrides_an_agent_until_that_speaks_again() -> None:
    obs = after(said("a", True, 1, 0.5, 0), said("person", False, 2, lifetime_s=None))
    assert known(obs, 2) is False
    obs.update([said("a", True, 3, 2.5, 0)])
    assert known(obs, 3) is True
    assert names(obs, 3) == []


def test_what_was_said_once_counts_until_another_speaks_whatever_its_lifetime_and_evidence() -> None:
    obs = after(*A_HEARS, said("person", False, 9, 6.5, lifetime_s=3600))  # a POST without `since`
    assert known(obs, 9) is False
    obs.update([said("a", True, 10, 9.5, 0)])
    assert known(obs, 10) is True
    assert names(obs, 10) == []
    obs.update([said("person", False, 11, 10.9, 6.5, lifetime_s=3600)])  # who insists, contradicts it
    assert names(obs, 11) == [(["a"], ["person"], None)]


def test_an_opposite_word_that_may_be_late_is_doubt() -> None:
    obs = after(said("a", True, 0.1, 0, 0), said("a", True, 1, 0.5, 0), said("b", False, 2, 1.5, 1.2))
    assert obs.doubted(2 * S) == {SCAN: 6 * S}
    obs.update([said("a", False, 2.5, 1.6, 1.2)])
    assert obs.doubted(round(2.5 * S)) == {}


def test_the_sources_of_an_atom_are_bounded() -> None:
    obs = Obs()
    for n in range(1000):
        obs.update([said(f"s{n}", n % 2 == 0, 1 + n / 1000, 0.5 + n / 1000, 0, 3600)])
    assert len(obs.entries()[0].by_source) == MAX_SOURCES
    assert len(obs) == 1


Row = tuple[str, bool, int, int, int | None, int, bool]

REPORTS = st.lists(
    st.tuples(
        st.sampled_from("abc"),
        st.booleans(),
        st.integers(0, 8),  # how far the evidence reaches back
        st.integers(0, 12),  # … and the beginning of it
        st.sampled_from([None, 3, 9]),
        st.integers(1, 6),  # after the report before
        st.booleans(),  # whether who reports that it is silent never heard it
    ),
    min_size=1,
    max_size=9,
)


def reported(rows: Sequence[Row]) -> list[Entry]:
    found, at = [], 100
    for source, holds, since, onset, lifetime, gap, never in rows:
        at += gap
        begin = at - since
        report = said(source, holds, at, begin, min(begin, at - onset), lifetime)
        found.append(replace(report, deaf=never and not holds))
    return found


def state(obs: Obs, at_s: float) -> tuple[object, ...]:
    entry = obs.get(SCAN)
    assert entry is not None
    words = {word.entry.source: (word.entry, until_ns(word)) for word in entry.by_source}
    return known(obs, at_s), replace(entry, by_source=()), words, names(obs, at_s)


@given(REPORTS, st.data())
def test_the_order_of_arrival_does_not_matter(rows: Sequence[Row], data: st.DataObject) -> None:
    in_time = reported(rows)
    shuffled = data.draw(st.permutations(in_time))
    at_s = in_time[-1].time_ns / S
    assert state(after(*in_time), at_s) == state(after(*shuffled), at_s)


@given(REPORTS)
def test_what_is_known_was_said_by_somebody_who_counts(
    rows: Sequence[Row],
) -> None:
    """Where all say the same, that is known; the cached answer is the true one, and so is the rebuilt one."""
    obs = Obs()
    for report in reported(rows):
        changed = obs.update([report])
        entry, at_ns = obs.get(SCAN), report.time_ns
        assert entry is not None
        last = {word.entry.source: word.entry for word in entry.by_source} or {entry.source: entry}
        value = obs.known(SCAN, at_ns)
        if len({word.positive for word in last.values()}) == 1:
            assert value is entry.positive or not entry.fresh(at_ns)
        assert obs.literals(at_ns) == (() if value is None else (Literal(SCAN, value),))
        assert obs.known_literals(at_ns) == frozenset(obs.literals(at_ns))
        assert len(changed) <= 1
        assert Obs(obs.entries()).get(SCAN) == entry


def deaf(at_s: float, since_s: float, lifetime_s: float | None = 5) -> Entry:
    """Return the report of a second agent that has never heard the scan."""
    return replace(said("b", False, at_s, since_s, lifetime_s=lifetime_s), deaf=True)


@pytest.mark.parametrize("heard", [(2.0,), (1.0, 2.0)], ids=["once", "again and again"])
def test_who_never_heard_it_says_no_news_beside_one_who_hears_it(heard: Sequence[float]) -> None:
    obs = after(*(said("a", True, at, at - 1.8, 0) for at in heard))
    seen = []
    for report in (deaf(2.3, 1.8), said("a", True, 3, 1.2, 0), deaf(3.3, 2.8), said("a", True, 4, 2.2, 0)):
        obs.update([report])
        seen.append(obs.known(SCAN, report.time_ns))
        assert names(obs, report.time_ns / S) in ([], [(["a"], ["b"], None)])
    assert seen == [None] * 4
    assert names(obs, 4) == [(["a"], ["b"], None)]
    # Once nobody hears it any more, it is silent; and what the deaf one hears is heard.
    obs.update([said("a", False, 5, 4.5, 4.4)])
    assert known(obs, 5) is False
    obs.update([said("b", True, 5.5, 5.2)])
    obs.update([said("a", True, 5.6, 5.2)])
    assert known(obs, 5.6) is True


def test_who_never_heard_it_is_believed_where_nobody_else_speaks() -> None:
    assert known(after(deaf(2.3, 1.8)), 2.3) is False
    lapsed = after(said("a", True, 1, 0.5, 0), said("a", True, 2, 1.5, 0), deaf(6, 5.5), deaf(8, 7.5))
    assert known(lapsed, 8) is False
