"""Which verdicts may be about to change."""

from __future__ import annotations

import pytest

from robomend.entry import Entry
from robomend.observations.pending import (
    GUARD_NS,
    SLACK_NS,
    Act,
    Confirmed,
    LastHeard,
    Unconfirmed,
    first_fallen,
    pending,
    returning,
    starting,
)
from robomend_client.literals import Atom, Literal

S = 10**9
SCAN, MAP, ODOM = (Atom("ok", (topic,)) for topic in ("scan", "map", "odom"))


def bad(atom: Atom, *, time: int, since: int | None = None, onset: int | None = None) -> Entry:
    return Entry(Literal(atom, False), "general", time, None, since, onset)


def test_what_fell_after_a_topic_that_it_rests_on_does_not_begin_the_waiting_anew() -> None:
    needs = {"scan": (), "odom": (), "map": ("scan",), "path": ("map", "scan")}
    path, running = Atom("ok", ("path",)), Atom("running", ("planner",))
    scan, map_, late = (bad(a, time=9 * S, onset=at * S) for a, at in ((SCAN, 5), (MAP, 6), (path, 7)))
    odom, ended = bad(ODOM, time=9 * S, onset=8 * S), bad(running, time=9 * S, onset=8 * S)

    def first(*symptoms: Entry) -> list[Entry]:
        return first_fallen(symptoms, lambda names: {name: needs[name] for name in names if name in needs})

    assert first(late, map_, scan) == [scan]
    assert first(late, scan) == [scan]
    assert first(late, map_) == [map_]
    assert first(scan, map_, odom, ended) == [scan, odom, ended]
    assert first(bad(SCAN, time=9 * S), map_) == [bad(SCAN, time=9 * S), map_]  # nobody knows when it fell


def test_a_verdict_is_pending_until_its_observer_had_its_time() -> None:
    delays = {MAP: 2 * S, ODOM: 1 * S}
    until = pending([MAP, ODOM], 10 * S, delays.__getitem__, 11 * S)
    assert until == {MAP: 12 * S + SLACK_NS, ODOM: 11 * S + SLACK_NS}
    assert pending([MAP, ODOM], 10 * S, delays.__getitem__, 11 * S + SLACK_NS) == {MAP: 12 * S + SLACK_NS}


def begun(
    known: list[Entry],
    began: dict[str, int],
    now: int,
    good: dict[Atom, tuple[int, ...]] | None = None,
    unseen: tuple[str, ...] = (),
    own_s: int = 5,
) -> dict[Atom, int]:
    """Ask of a driver of the scan, and the mapping that makes a map of it; what rests on what they publish
    may take 5 s to show that they have started.
    """
    rests_on = {"driver": {"driver", "scan", "map"}, "mapping": {"mapping", "map"}}
    own = {"driver": {"scan"}, "mapping": {"map"}}
    return starting(
        known,
        began,
        lambda _: (own_s * S, 5 * S),
        rests_on.__getitem__,
        own.__getitem__,
        lambda entry: (good or {}).get(entry.atom, ()),
        now,
        unseen,
    )


def test_silence_of_what_rests_on_something_that_has_just_begun_is_pending() -> None:
    began = {"driver": 10 * S, "mapping": 2 * S}
    scan, map_, odom = (bad(atom, time=12 * S, onset=8 * S) for atom in (SCAN, MAP, ODOM))
    assert begun([scan, map_, odom], began, 12 * S) == {SCAN: 15 * S, MAP: 15 * S}
    assert begun([odom, scan], began, 12 * S) == {SCAN: 15 * S}  # in whatever order they are known
    over_first = dict(reversed(began.items()))  # what has had its time hides nobody that comes after it
    end = 15 * S
    assert begun([scan], over_first, 12 * S) == {SCAN: end}
    assert begun([scan], began, end - 1) == {SCAN: end}
    assert begun([scan], began, end) == {}
    assert begun([bad(Atom("running", ("driver",)), time=12 * S)], began, 12 * S) == {}


def test_its_own_topics_are_waited_for_as_long_as_they_take_and_not_for_those_behind_them() -> None:
    scan, map_ = (bad(atom, time=12 * S, onset=8 * S) for atom in (SCAN, MAP))
    assert begun([scan, map_], {"driver": 10 * S}, 12 * S, own_s=3) == {SCAN: 13 * S, MAP: 15 * S}
    assert begun([scan, map_], {"driver": 10 * S}, 13 * S, own_s=3) == {MAP: 15 * S}


def test_of_a_driver_that_nobody_observes_what_came_up_after_it_shows_that_it_is_up() -> None:
    def silent(good: tuple[int, ...]) -> bool:
        map_ = bad(MAP, time=13 * S, onset=12 * S)
        return MAP in begun([map_], {"driver": 10 * S}, 13 * S, {MAP: good})

    assert not silent((11 * S,))
    assert silent((9 * S,))
    assert silent(())


def test_what_was_heard_since_it_began_is_not_silent_because_it_starts() -> None:
    def silent(scan: Entry, map_: Entry) -> set[Atom]:
        return set(begun([scan, map_], {"driver": 10 * S}, 13 * S))

    fell = {at: (bad(SCAN, time=13 * S, onset=at * S), bad(MAP, time=13 * S, onset=at * S)) for at in (9, 12)}
    assert silent(*fell[12]) == set()
    assert silent(*fell[9]) == {SCAN, MAP}
    # So near to its beginning, the last sample may be that of its predecessor.
    near = 10 * S + GUARD_NS
    assert silent(bad(SCAN, time=13 * S, onset=near), fell[12][1]) == {SCAN, MAP}
    assert silent(bad(SCAN, time=13 * S, onset=near + 1), fell[12][1]) == set()
    # What lived for a moment longer than its input, which is not back yet, waits for it.
    assert silent(fell[9][0], fell[12][1]) == {SCAN, MAP}
    # What fell silent before its input did, may have waited for it all the while.
    assert silent(fell[12][0], fell[9][1]) == {MAP}
    assert silent(fell[12][0], bad(MAP, time=13 * S)) == {MAP}
    assert silent(bad(SCAN, time=13 * S), fell[12][1]) == {SCAN, MAP}


def test_what_was_good_after_its_input_was_is_not_silent_because_that_started() -> None:
    scan = Entry(Literal(SCAN), "general", 13 * S)

    def silent(good: tuple[int, ...], fell: int, **began: int) -> bool:
        map_ = bad(MAP, time=13 * S, onset=fell)
        return MAP in begun([scan, map_], began or {"driver": 10 * S}, 13 * S, {SCAN: good})

    assert not silent((11 * S,), 12 * S)
    # It fell silent for want of its input, which is back: so it may be, too, in a moment.
    assert silent((12 * S,), 11 * S)
    # The scan's evidence is from before: its driver may have said nothing yet.
    assert silent((9 * S,), 12 * S)
    assert not silent((9 * S, 11 * S), 12 * S)
    assert silent((), 12 * S)
    # So near to its beginning it may be its predecessor's, as clocks go.
    assert silent((10 * S + GUARD_NS,), 12 * S)
    assert not silent((10 * S + GUARD_NS + 1,), 12 * S)
    # The input is up, and what makes the map of it has only begun.
    assert silent((11 * S,), 12 * S, driver=10 * S, mapping=12 * S)
    assert not silent((11 * S,), 12 * S, driver=10 * S, mapping=10 * S)


def test_what_rests_on_something_that_is_back_may_be_back_too() -> None:
    """A fault went by itself: the scan is good since 20 s, and the map's observer needs 2 s to judge anew."""

    def pending_at(now: int, onset: int | None, risen: dict[str, int]) -> dict[Atom, int]:
        symptoms = [bad(MAP, time=19 * S, onset=onset), bad(ODOM, time=19 * S, onset=onset)]
        return returning(symptoms, risen, lambda _: {"map": {"scan"}}, lambda _: 2 * S, now)

    end = 22 * S + SLACK_NS
    assert pending_at(21 * S, 15 * S, {"scan": 20 * S}) == {MAP: end}
    assert pending_at(21 * S, None, {"scan": 20 * S}) == {MAP: end}
    assert pending_at(end - 1, 15 * S, {"scan": 20 * S}) == {MAP: end}
    assert pending_at(end, 15 * S, {"scan": 20 * S}) == {}
    # It fell silent when the scan was back already: that is another fault.
    assert pending_at(21 * S, 20 * S + 1, {"scan": 20 * S}) == {}
    assert pending_at(21 * S, 15 * S, {"pose": 20 * S}) == {}
    assert returning([], {"scan": 20 * S}, lambda _: {}, lambda _: 2 * S, 21 * S) == {}


def test_how_long_a_verdict_is_pending_is_a_matter_of_its_own_observer() -> None:
    symptoms = [bad(MAP, time=19 * S, onset=15 * S), bad(ODOM, time=19 * S, onset=15 * S)]
    needs = {"map": {"scan"}, "odom": {"scan"}}
    settling_ns = {MAP: 1 * S, ODOM: 3 * S}.__getitem__
    found = returning(symptoms, {"scan": 20 * S}, lambda _: needs, settling_ns, 21 * S + SLACK_NS)
    assert found == {ODOM: 23 * S + SLACK_NS}


def test_who_repeats_itself_is_silent_when_it_was_not_heard_since() -> None:
    heard = LastHeard()
    for n in range(5):
        heard.hear("agent", n * S, again=True, lives_ns=2 * S)
    assert heard.usual_ns("agent") == S
    assert heard.silent_since("agent", 5 * S)
    assert not heard.silent_since("agent", 3 * S)
    assert heard.interruption("agent") is None
    heard.hear("agent", 9 * S, again=True, lives_ns=2 * S)
    assert heard.interruption("agent") == (4 * S, 9 * S)
    assert heard.usual_ns("agent") == S  # to be cut off once is no rhythm


# --- what is evidence after an act, and what is not

ACT = Act(7, 1000 * 10**9)


def said(
    positive: bool = True, *, since: int | None = None, settled: int | None = None, lives: bool = True
) -> Entry:
    expires = 2000 * 10**9 if lives else None
    return Entry(Literal(SCAN, positive), "general", 1001 * 10**9, expires, since, None, settled)


def after_act() -> Unconfirmed:
    unconfirmed = Unconfirmed()
    unconfirmed.touch([SCAN, MAP], ACT)
    return unconfirmed


@pytest.mark.parametrize("positive", [True, False])
def test_evidence_from_before_the_answer_confirms_nothing_of_either_sign(positive: bool) -> None:
    unconfirmed = after_act()
    assert not unconfirmed.hear([said(positive, since=ACT.from_ns)])
    assert not unconfirmed.hear([said(positive, since=ACT.from_ns + GUARD_NS)])
    assert not unconfirmed.hear([said(positive, since=None)])
    assert SCAN in unconfirmed


def test_evidence_from_after_the_answer_confirms_its_atom_alone() -> None:
    unconfirmed = after_act()
    assert unconfirmed.hear([said(since=ACT.from_ns + GUARD_NS + 1)])
    assert SCAN not in unconfirmed
    assert MAP in unconfirmed


def test_an_answer_to_settle_confirms_whatever_the_clocks_say() -> None:
    unconfirmed = after_act()
    assert not unconfirmed.hear([said(since=1, settled=6)])
    assert unconfirmed.hear([said(since=1, settled=7)])
    unconfirmed = after_act()
    assert unconfirmed.hear([said(False, settled=8)])


def test_once_confirmed_it_stays_so_until_the_next_act() -> None:
    unconfirmed = after_act()
    unconfirmed.hear([said(settled=7)])
    unconfirmed.hear([said(since=1)])  # a late repetition of what was said before
    assert SCAN not in unconfirmed
    unconfirmed.touch([SCAN], Act(8, 1005 * 10**9))
    assert SCAN in unconfirmed
    assert not unconfirmed.hear([said(settled=7)])


def test_who_speaks_on_change_only_confirms_by_saying_nothing_for_as_long_as_observers_need() -> None:
    unconfirmed, delay = after_act(), 2 * 10**9
    on_change, repeated = said(lives=False), said()
    assert unconfirmed.how(on_change, delay, ACT.from_ns + delay - 1) is Confirmed.NOT
    assert unconfirmed.how(on_change, delay, ACT.from_ns + delay) is Confirmed.BY_SILENCE
    assert unconfirmed.how(repeated, delay, ACT.from_ns + 10 * delay) is Confirmed.NOT


def test_what_is_cleared_or_forgotten_needs_no_evidence() -> None:
    unconfirmed = after_act()
    unconfirmed.forget([SCAN])
    assert list(unconfirmed.acts) == [MAP]
    unconfirmed.clear()
    assert not unconfirmed.acts
