"""Which verdicts may be about to change."""

from __future__ import annotations

from robomend.entry import Entry
from robomend.observations.pending import SLACK_NS, newest_onset, pending, starting
from robomend_client.literals import Atom, Literal

S = 10**9
SCAN, MAP, ODOM = (Atom("ok", (topic,)) for topic in ("scan", "map", "odom"))


def bad(atom: Atom, *, time: int, since: int | None = None, onset: int | None = None) -> Entry:
    return Entry(Literal(atom, False), "general", time, None, since, onset)


def test_the_newest_onset_is_that_of_the_symptom_that_began_last() -> None:
    said = [bad(SCAN, time=10 * S, onset=7 * S), bad(MAP, time=11 * S, since=8 * S), bad(ODOM, time=6 * S)]
    assert newest_onset(said) == 8 * S
    assert newest_onset([Entry(Literal(SCAN), "general", 9 * S)]) is None


def test_a_verdict_is_pending_until_its_observer_had_its_time() -> None:
    delays = {MAP: 2 * S, ODOM: 1 * S}
    until = pending([MAP, ODOM], 10 * S, delays.__getitem__, 11 * S)
    assert until == {MAP: 12 * S + SLACK_NS, ODOM: 11 * S + SLACK_NS}
    assert pending([MAP, ODOM], 10 * S, delays.__getitem__, 11 * S + SLACK_NS) == {MAP: 12 * S + SLACK_NS}


def test_silence_of_what_rests_on_something_that_has_just_begun_is_pending() -> None:
    rests_on = {"driver": {"driver", "scan", "map"}, "mapping": {"mapping", "map"}}
    began = {"driver": 10 * S, "mapping": 2 * S}
    found = starting([SCAN, MAP, ODOM], began, lambda _: 5 * S, rests_on.__getitem__, 12 * S)
    assert found == {SCAN: 15 * S + SLACK_NS, MAP: 15 * S + SLACK_NS}
    over_first = dict(reversed(began.items()))  # what has had its time hides nobody that comes after it
    assert starting([SCAN], over_first, lambda _: 5 * S, rests_on.__getitem__, 12 * S) == {
        SCAN: 15 * S + SLACK_NS
    }
    end = 15 * S + SLACK_NS
    assert starting([SCAN], began, lambda _: 5 * S, rests_on.__getitem__, end - 1) == {SCAN: end}
    assert starting([SCAN], began, lambda _: 5 * S, rests_on.__getitem__, end) == {}
    running = Atom("running", ("driver",))
    assert starting([running], began, lambda _: 5 * S, rests_on.__getitem__, 12 * S) == {}
