"""From when evidence is, by the service's clock: what batches say, what is taken where they do not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend.entry import Entry
from robomend.errors import InputError
from robomend.observations.obs import Obs
from robomend.robots.dating import ENOUGH, Dating, RestsOn, SourceClocks, Twins
from robomend.robots.declared import Declaration, DeclaredAgents, Delays
from robomend.robots.sight import Sight
from robomend_client.literals import Atom, Literal
from robomend_client.readings import Reading, Symptom

S = 10**9
NOW = 1000 * S
OK, BAD = Literal(Atom("ok", ("scan",))), Literal(Atom("ok", ("scan",)), False)
RUNNING = Literal(Atom("running", ("driver",)))


def dated(obs: Obs, *since: int | None, onset: tuple[int | None, ...] = (), time: int = NOW) -> RestsOn:
    return Dating(obs, SourceClocks(), 2 * S).of("general", time, NOW, 1, since, onset)


def test_how_much_reports_differ_on_their_way_is_that_of_the_source_that_differs_most() -> None:
    clocks = SourceClocks()
    assert clocks.spread_ns() is None
    for number in range(ENOUGH):
        assert clocks.spread_ns() is None
        clocks.offset_ns("agent", NOW + number * S - 10_000_000 * (number + 1), NOW + number * S)
    assert clocks.spread_ns() == 30_000_000
    clocks.offset_ns("arm", NOW, NOW)
    assert clocks.spread_ns() is None  # of a source that nobody knows yet
    for number in range(ENOUGH):
        clocks.offset_ns("arm", NOW + number * S + 90 * S, NOW + number * S)  # its clock is ahead, no more
    assert clocks.spread_ns() == 90 * S


def test_without_it_the_usual_delay_is_taken_off_but_not_of_readings_nor_of_good_news_after_bad() -> None:
    assert dated(Obs())(OK, 0) == (NOW - 2 * S, None)
    assert dated(Obs([Entry(OK, "general", 1)]))(OK, 0)[0] == NOW - 2 * S
    assert dated(Obs([Entry(BAD, "general", 1)]))(OK, 0)[0] == NOW
    assert dated(Obs([Entry(OK, "general", 1)]))(BAD, 0)[0] == NOW - 2 * S
    assert dated(Obs())(RUNNING, 0) == (NOW, NOW)


def test_values_that_do_not_fit_are_refused_with_their_place() -> None:
    with pytest.raises(InputError, match="since: 2 values for 1 observations"):
        dated(Obs(), 1, 2)
    with pytest.raises(InputError, match=r"since\[0\]: .* is after the time of the batch"):
        dated(Obs(), NOW + 1)
    with pytest.raises(InputError, match=r"onset\[0\]"):
        dated(Obs(), None, onset=(NOW + 1,))


def test_a_clock_that_is_ahead_is_followed_at_once_and_one_that_is_behind_when_that_is_sure() -> None:
    clocks = SourceClocks()
    assert clocks.offset_ns("ahead", NOW + 90 * S, NOW) == -90 * S
    for number in range(ENOUGH - 1):
        assert clocks.offset_ns("behind", NOW - 90 * S + number * S, NOW + number * S) == 0
    assert clocks.offset_ns("behind", NOW - 80 * S, NOW + 10 * S) == 90 * S


@given(
    st.lists(
        st.tuples(st.integers(0, 5), st.integers(-400, 60), st.integers(0, 400)), min_size=1, max_size=40
    )
)
def test_no_evidence_is_from_the_services_future_whatever_a_source_stamps(
    batches: list[tuple[int, int, int]],
) -> None:
    clocks, arrival_ns = SourceClocks(), NOW
    for (
        after_s,
        ahead_s,
        old_s,
    ) in batches:  # a batch comes, is stamped so far ahead, and rests on what is so old
        arrival_ns += after_s * S
        stamp_ns = arrival_ns + ahead_s * S
        rests_on = Dating(Obs(), clocks, 2 * S).of(
            "agent", stamp_ns, arrival_ns, 1, [stamp_ns - old_s * S], ()
        )
        since_ns, _ = rests_on(OK, 0)
        assert since_ns <= arrival_ns - old_s * S


def test_what_holds_is_known_to_since_it_was_news_and_since_its_present_evidence() -> None:
    held = Obs()
    sight = Sight(cast(Any, SimpleNamespace(id="r1", obs=held)))

    def said(*entries: Entry) -> tuple[int, ...]:
        sight.hear(entries, held.update(entries))
        return sight.good_ns(entries[-1])

    def ok(time: int, since: int) -> Entry:
        return Entry(OK, "general", time * S, None, since * S)

    assert said(ok(10, 9)) == (9 * S, 9 * S)
    assert said(ok(11, 9)) == (9 * S, 9 * S)
    assert said(ok(20, 19)) == (9 * S, 19 * S, 19 * S)  # where the first is in doubt, this one is not
    assert said(ok(30, 29)) == (9 * S, 19 * S, 29 * S)
    # What fell was good from then until it did; that it is said to be silent anew, or later, changes nothing.
    assert said(Entry(BAD, "general", 40 * S, None, 39 * S, 38 * S)) == (9 * S, 19 * S)
    assert said(Entry(BAD, "general", 45 * S, None, 44 * S, 43 * S)) == (9 * S, 19 * S)
    assert said(ok(50, 49)) == (49 * S, 49 * S)
    assert said(Entry(BAD, "general", 60 * S, None, 59 * S)) == (49 * S,)


def test_a_topic_that_is_heard_again_is_not_looked_at_to_the_end_before_its_observer_has_settled() -> None:
    """Silence of 0.5 s, checked each 0.1 s: 0.6 s to detect it, and 1.3 s to judge anew."""
    held = Obs()
    sight = Sight(cast(Any, SimpleNamespace(id="r1", obs=held)))
    sight.declared = cast(Any, SimpleNamespace(delays=lambda atom, usual: Delays(6 * S // 10, 13 * S // 10)))

    def looked(told_ms: int, since_ms: int, symptom: Symptom | None = None) -> int:
        ms, reading = S // 1000, Reading("bad", symptom=symptom)
        held.update([Entry(BAD, "general", told_ms * ms, None, since_ms * ms, reading=reading)])
        return sight.looked_ns(OK.atom) // ms

    assert sight.looked_ns(OK.atom) == 0
    assert looked(10_000, 9_500) == 10_100  # silent until now, and noticed with the next check
    # The first sample came at 10.2 s: it is still called bad, on the silence before it.
    assert looked(10_400, 9_700) < 10_200
    assert looked(11_500, 9_700) < 10_200
    assert looked(11_700, 9_700) == 11_700  # it had its time, and is at a wrong rate
    # Of a rate that is too low it is the oldest sample of the window that moves on like that.
    assert looked(12_400, 11_700, Symptom.SILENT) < 12_200
    assert looked(12_400, 11_700, Symptom.SLOW) == 12_400
    assert sight.turns_ns(OK.atom) == 0


@pytest.mark.parametrize(
    ("source", "after_ms", "seen"),
    [("board", 1, True), ("board", -1, False), ("agent", 1, False), ("agent", 51, True)],
)
def test_the_board_s_readings_need_no_room_for_clocks_that_differ(
    source: str, after_ms: int, seen: bool
) -> None:
    held = Obs()
    sight = Sight(cast(Any, SimpleNamespace(id="r1", obs=held)))
    on = Literal(Atom("on", ("lidar",)))
    held.update([Entry(-on, source, NOW - S, None, NOW - S)])
    sight.acted({on.atom}, NOW, (), NOW + S // 100)
    entry = Entry(on, source, NOW + after_ms * S // 1000, None, NOW + after_ms * S // 1000)
    sight.hear([entry], held.update([entry]))
    assert (on.atom not in sight.unconfirmed) is seen


def test_a_clock_that_was_ahead_and_is_set_right_is_right_after_a_few_batches() -> None:
    clocks = SourceClocks()
    for number in range(20):
        assert clocks.offset_ns("agent", NOW + (number + 40) * S, NOW + number * S) == -40 * S
    found = [
        clocks.offset_ns("agent", NOW + number * S - 5_000_000, NOW + number * S) for number in range(20, 26)
    ]
    assert found == [-40 * S] * (ENOUGH - 1) + [5_000_000] * 3


def test_a_source_that_contradicts_itself_again_and_again_is_two() -> None:
    obs, twins = Obs(), Twins()

    def said(literal: Literal, at_s: float, since_s: float, onset_s: float | None = None) -> list[str]:
        time_ns, since_ns = NOW + round(at_s * S), NOW + round(since_s * S)
        onset_ns = None if onset_s is None else NOW + round(onset_s * S)
        rests_on = Dating(obs, SourceClocks(), 0, twins).of("a", time_ns, time_ns, 1, [since_ns], [onset_ns])
        obs.update([Entry(literal, "a", time_ns, None, *rests_on(literal, 0))])
        return twins.names(time_ns)

    # One observer turns by what it saw after what it said before.
    for at in range(0, 60, 10):
        assert said(OK, at, at - 0.5) == []
        assert said(OK, at + 2, at + 1.5) == []
        assert said(BAD, at + 4, at + 3, at + 2.9) == []
        assert said(BAD, at + 6, at + 5, at + 2.9) == []
    # Of two, one has heard the topic all along, and the other has not.
    found = []
    for at in range(60, 68):
        found += [said(OK, at, at - 0.5), said(BAD, at + 0.5, at - 0.2, 50)]
    assert found[2] == []
    assert found[-1] == ["a"]
    assert twins.names(NOW + 200 * S) == []


def test_agents_of_one_name_that_poll_from_two_hosts_are_told_and_one_that_moved_is_not() -> None:
    agents = DeclaredAgents()
    for host in ("pc1", "pc1", "pc2", "pc2"):
        agents.hear(Declaration("onboard", host))
        assert agents.of_one_name() == []
    agents.hear(Declaration("onboard", "pc1"))
    assert agents.of_one_name() == [("onboard", ("pc2", "pc1"))]
