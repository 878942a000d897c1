"""The driver: one order of events; settling; time that jumps; observers that raise."""

from __future__ import annotations

import inspect
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.clients.observers.driving import RATE, SCAN, Told, bare, beat, values

from robomend_client.literals import Atom, Literal, fails, holds
from robomend_client.observers import (
    PROCESSES,
    SECOND,
    Band,
    BinaryQualitativeObserver,
    Change,
    Contact,
    Driver,
    FunctionObserver,
    GeneralObserver,
    NodeObserver,
    Observer,
    ObserverProblem,
    PropertyObserver,
    QualitativeObserver,
    Rate,
    Table,
    Trend,
    Verdict,
    ns,
)
from robomend_client.observers.observer_state import CHANCES

# --- the order of events ----------------------------------------------------------------------------------


def test_a_sample_that_nobody_wants_is_nothing() -> None:
    driver = Driver([Told("a")], 0)
    assert (driver.sample("b", ns(1), 1), driver.now_ns) == ((), 0)


@given(st.lists(st.integers(0, 400), max_size=80), st.lists(st.integers(0, 30_000), max_size=30))
def test_when_the_timer_wakes_up_makes_no_difference(gaps_ms: list[int], wakes_ms: list[int]) -> None:
    def run(wakes_ns: list[int]) -> list[Change]:
        driver = Driver([GeneralObserver("scan", RATE)], 0)
        changes: list[Change] = []
        time_ns = 0
        for gap_ms in gaps_ms:
            time_ns += gap_ms * 1_000_000
            while wakes_ns and wakes_ns[0] < time_ns:
                changes += driver.advance(wakes_ns.pop(0))
                driver.standing()
            changes += driver.sample("scan", time_ns, now_ns=time_ns)
        return [*changes, *driver.advance(time_ns + SECOND)]

    assert run(sorted(ms * 1_000_000 for ms in wakes_ms)) == run([])


# --- settling ---------------------------------------------------------------------------------------------


def test_settled_observers_judge_anew_and_say_so_with_the_number() -> None:
    driver = Driver([GeneralObserver("scan", RATE)], 0)
    beat(driver, "scan", 0, 20)
    driver.advance(ns(1.95))
    assert driver.settle(7, [SCAN, Atom("ok", ("other",))]) == []
    assert bare(driver.standing()) == [Verdict(holds("ok", "scan"), ns(0.9))]  # stands, on what it rested on
    (again,) = beat(driver, "scan", 2.0, 7)
    assert again._replace(reading=None) == Change(ns(2.6), SCAN, holds("ok", "scan"), ns(2.0), None, 7)
    assert beat(driver, "scan", 2.7, 20) == []


def test_a_successor_that_stays_mute_is_not_ok_after_it_was_settled() -> None:
    driver = Driver([GeneralObserver("scan", Rate.published())], 0)
    beat(driver, "scan", 0, 20)
    driver.settle(1, [SCAN])
    (mute,) = driver.advance(ns(5))
    assert (mute.value, mute.settled, mute.since_ns) == (fails("ok", "scan"), 1, ns(1.9))


def test_what_is_seen_only_later_is_still_judged_anew() -> None:
    driver = Driver([Told("a", settling_s=2)], 0)
    driver.sample("a", ns(1), 1, ns(1))
    driver.settle(3, [SCAN])
    assert [(c.value, c.settled) for c in driver.advance(ns(20))] == [(None, 3)]
    said = [
        change
        for at_s, value in ((21, 1), (22, 1), (23, 0))
        for change in driver.sample("a", ns(at_s), value, ns(at_s))
    ]
    assert [(str(c.value), c.settled) for c in said] == [("ok(scan)", 3), ("not ok(scan)", None)]
    # Unknown is told once, with the number that it answers; a later one is answered by itself.
    driver.settle(4, [SCAN])
    driver.settle(5, [SCAN])
    assert [(c.value, c.settled) for c in driver.advance(ns(40))] == [(None, 5)]
    driver.settle(6, [SCAN])
    assert [(c.value, c.settled) for c in driver.advance(ns(60))] == [(None, 6)]
    assert [c.settled for c in driver.sample("a", ns(61), 0, ns(61))] == [6]


def test_samples_from_before_do_not_settle_anything() -> None:
    driver = Driver([Told("a")], 0)
    driver.advance(ns(5))
    driver.settle(1, [SCAN])
    assert values(driver.sample("a", ns(4.9), 1, ns(5.1))) == []
    assert [(c.value, c.settled) for c in driver.sample("a", ns(5), 1, ns(5.1))] == [(holds("ok", "scan"), 1)]


def test_bad_news_settles_at_once_and_good_news_when_all_have_judged() -> None:
    driver = Driver([Told("a"), Told("b")], 0)
    driver.settle(1, [SCAN])
    assert [(str(c.value), c.settled) for c in driver.sample("a", ns(0.1), 1, ns(0.1))] == [
        ("ok(scan)", None)
    ]
    assert [(str(c.value), c.settled) for c in driver.sample("b", ns(0.2), 1, ns(0.2))] == [("ok(scan)", 1)]
    driver.settle(2, [SCAN])
    assert [(str(c.value), c.settled) for c in driver.sample("a", ns(0.3), 0, ns(0.3))] == [
        ("not ok(scan)", 2)
    ]
    assert values(driver.sample("b", ns(0.4), 1, ns(0.4))) == []


# --- time that jumps --------------------------------------------------------------------------------------


def test_a_stamp_from_the_future_is_left_out_and_told_once() -> None:
    problems: list[ObserverProblem] = []
    driver = Driver([GeneralObserver("scan", RATE)], 0, on_problem=problems.append)
    assert values(beat(driver, "scan", 0, 11)) == ["ok(scan)"]
    for k in range(3):
        assert driver.sample("scan", ns(3600), now_ns=ns(1.05 + k / 100)) == ()
    assert values(beat(driver, "scan", 1.1, 20)) == []
    assert [(p.what, p.where) for p in problems] == [("ahead", "scan")]
    assert driver.problems.counts["ahead", "scan"] == 3
    assert "3.6e+03 s ahead of this computer's clock: left out" in problems[0].message


def test_a_stamp_from_the_future_is_left_out_of_a_log() -> None:
    driver = Driver([GeneralObserver("scan", RATE)], 0)
    changes: list[Change] = []
    for k in range(40):
        changes += driver.sample("scan", ns(k / 10))
        if k == 20:
            changes += driver.sample("scan", ns(3600))
    assert values(changes) == ["ok(scan)"]
    assert driver.problems.counts == {("jump", "scan"): 1}


def test_a_gap_of_a_log_is_silence() -> None:
    driver = Driver([GeneralObserver("scan", RATE)], 0)
    changes: list[Change] = []
    for k in (*range(20), *range(1000, 1020)):
        changes += driver.sample("scan", ns(k / 10))
    assert [(str(c.value), c.time_ns) for c in changes] == [
        ("ok(scan)", ns(0.6)),
        ("not ok(scan)", ns(2.4)),
        ("ok(scan)", ns(100.6)),
    ]


def test_a_log_that_begins_again_begins_anew() -> None:
    driver = Driver([GeneralObserver("scan", RATE)], 0)
    changes: list[Change] = []
    for k in (*range(100), *range(20)):
        changes += driver.sample("scan", ns(k / 10))
    assert [(str(c.value), c.time_ns) for c in changes] == [
        ("ok(scan)", ns(0.6)),
        ("None", 0),
        ("ok(scan)", ns(0.6)),
    ]


def test_one_old_sample_in_a_log_does_not_begin_anew() -> None:
    driver = Driver([GeneralObserver("scan", RATE), Told("a", Atom("ok", ("a",)))], 0)
    changes: list[Change] = []
    for k in range(100):
        changes += driver.sample("scan", ns(k / 10))
        if k == 50:
            changes += driver.sample("a", ns(1), 1)
    assert values(changes) == ["ok(scan)"]
    assert driver.problems.counts == {("jump", "a"): 1}


def test_a_jump_at_the_end_of_a_log_counts_if_the_log_goes_on_to_there() -> None:
    for end_s, expected in (
        (100.5, ["ok(scan)", "not ok(scan)", "ok(a)"]),
        (3.0, ["ok(scan)", "not ok(scan)"]),
    ):
        driver = Driver([GeneralObserver("scan", RATE), Told("a", Atom("ok", ("a",)))], 0)
        changes = [c for k in range(20) for c in driver.sample("scan", ns(k / 10))]
        changes += driver.sample("a", ns(100), 1)
        changes += driver.advance(ns(end_s))
        assert values(changes) == expected


def test_time_that_nobody_looked_at_is_no_silence() -> None:
    driver = Driver([GeneralObserver("scan", RATE)], 0)
    beat(driver, "scan", 0, 20)
    assert driver.lapse(ns(8)) == []
    # What waited in the meantime comes all at once, and tells nothing of the rate.
    assert [c for k in range(60) for c in driver.sample("scan", ns(7.95), now_ns=ns(7.95))] == []
    assert bare(driver.standing()) == [Verdict(holds("ok", "scan"), ns(0.9))]
    assert beat(driver, "scan", 8.0, 20) == []
    assert [v.since_ns >= ns(8) for v in driver.standing()] == [True]


@pytest.mark.parametrize(
    ("hz", "slow_s", "starved_s", "fed_s", "expected"),
    [
        (5.0, 4.0, None, None, [(4.5, "not ok(scan)")]),
        (5.0, 4.0, 4.2, None, [(4.5, "None")]),
        (5.0, 4.0, 4.2, 8.0, [(4.5, "None"), (9.3, "not ok(scan)")]),  # a window of 9 Hz at least later
        (5.0, 4.0, 5.5, None, [(4.5, "not ok(scan)")]),  # it was slow before
        (5.0, 4.0, None, 4.2, [(4.5, "not ok(scan)")]),  # that it is no more says nothing of before
        (0.0, 4.0, None, None, [(4.5, "not ok(scan)")]),
        (0.0, 4.0, 4.2, None, [(8.5, "not ok(scan)")]),
        (0.0, 4.0, 4.2, 5.0, [(6.3, "not ok(scan)")]),
        (0.0, 4.0, 4.8, None, [(4.5, "not ok(scan)")]),
    ],
)
def test_on_a_starved_computer_slow_is_unknown_and_silence_counts_later(
    hz: float, slow_s: float, starved_s: float | None, fed_s: float | None, expected: list[tuple[float, str]]
) -> None:
    """It is at 10 Hz until `slow_s`, and at `hz` then."""
    driver, end_s = Driver([GeneralObserver("scan", RATE)], 0), 12.0
    times_s = [k / 10 for k in range(round(slow_s * 10))]
    times_s += [slow_s + k / hz for k in range(round((end_s - slow_s) * hz))]
    happens = [(time_s, "scan") for time_s in times_s]
    happens += [(at_s, what) for at_s, what in ((starved_s, "starved"), (fed_s, "fed")) if at_s is not None]
    found: list[Change] = []
    for at_s, what in sorted(happens):
        if what == "scan":
            found += driver.sample(what, ns(at_s), now_ns=ns(at_s))
        else:
            found += driver.starved(what == "starved", ns(at_s))
    found += driver.advance(ns(end_s))
    after = [(c.time_ns / SECOND, str(c.value)) for c in found if c.time_ns > ns(slow_s)]
    assert [value for _, value in after] == [value for _, value in expected]
    assert [at_s for at_s, _ in after] == pytest.approx([at_s for at_s, _ in expected], abs=0.35)


def test_who_is_starved_and_looks_away_again_and_again_finds_a_silent_topic_all_the_same() -> None:
    driver, found = Driver([GeneralObserver("scan", RATE)], 0), []
    beat(driver, "scan", 0, 40)
    driver.starved(True, ns(4))
    for at_s in range(4, 20, 2):
        found += [*driver.lapse(ns(at_s + 0.6)), *driver.advance(ns(at_s + 2))]
    (silent,) = [change for change in found if str(change.value) == "not ok(scan)"]
    assert 8 < silent.time_ns / SECOND < 12  # 4 s later than else, and once somebody looked for long enough


def test_after_time_that_nobody_looked_at_a_silent_topic_is_found_silent() -> None:
    driver = Driver([GeneralObserver("scan", RATE)], 0)
    beat(driver, "scan", 0, 20)
    driver.lapse(ns(8))
    (silent,) = driver.advance(ns(9))
    assert (silent.time_ns, silent.value, silent.since_ns) == (ns(8.5), fails("ok", "scan"), ns(8))


def test_a_fault_that_is_judged_anew_and_goes_on_began_when_it_began() -> None:
    driver = Driver([GeneralObserver("scan", RATE)], 0)
    beat(driver, "scan", 0, 20)  # the last one at 1.9 s
    driver.advance(ns(3))
    driver.lapse(ns(8))
    driver.advance(ns(9))
    assert bare(driver.standing()) == [Verdict(fails("ok", "scan"), ns(8.5), ns(1.9))]
    (again,) = [*driver.settle(7, [SCAN]), *driver.advance(ns(10))]
    assert (again.time_ns, again.settled, again.since_ns, again.onset_ns) == (ns(9.5), 7, ns(9), ns(1.9))
    driver.settle(8, [SCAN])
    assert values(beat(driver, "scan", 10.0, 20)) == ["ok(scan)"]
    (silent,) = driver.advance(ns(20))
    assert silent.onset_ns == ns(11.9)


@pytest.mark.parametrize("rate", [Rate.published(), Rate(), Rate(rate_hz=100, tolerance_hz=10)])
@pytest.mark.parametrize("late_s", [0.05, 0.2, 0.6, 3.0])
@pytest.mark.parametrize("settled_s", [0.1, 0.7, 4.0])
def test_however_late_an_agent_is_the_rate_stays_what_it_is(
    rate: Rate, late_s: float, settled_s: float
) -> None:
    driver = Driver([GeneralObserver("scan", rate)], 0)
    # Held up twice, the second time so soon after the first; what is sent meanwhile comes at the end of it.
    held_up = [(5.03, 5.03 + late_s), (5.03 + late_s + settled_s, 5.03 + 2 * late_s + settled_s)]
    changes: list[Change] = []
    over = 0
    for k in range(round((10 + 2 * late_s + settled_s) * rate.rate_hz)):
        due_s = k / rate.rate_hz
        heard_s = next((end_s for begin_s, end_s in held_up if begin_s <= due_s <= end_s), due_s)
        if over < 2 and heard_s >= held_up[over][1]:
            changes += driver.advance(ns(held_up[over][0]))
            changes += driver.lapse(ns(held_up[over][1] + 0.02))
            over += 1
        changes += driver.sample("scan", ns(heard_s), now_ns=ns(heard_s))
    said = [change.value for change in changes]
    settling_s = driver.delays_s(SCAN)[1]
    if late_s + settled_s < settling_s:
        assert said == [holds("ok", "scan")]
    else:  # nobody has judged for longer than that takes
        assert fails("ok", "scan") not in said
        assert said[-1] == holds("ok", "scan")


def test_what_an_agent_says_that_is_late_again_and_again_becomes_unknown_and_comes_back() -> None:
    driver = Driver([GeneralObserver("scan", RATE)], 0)
    (settling_s,) = {driver.delays_s(atom)[1] for atom in driver.atoms}
    changes: list[Change] = [*beat(driver, "scan", 0, 20)]
    at_s = 2.0
    looked_s = 0.3
    assert looked_s < settling_s
    while at_s < 60.0:  # late for a second, again and again before it has judged
        changes += driver.lapse(ns(at_s + 1.0))
        changes += beat(driver, "scan", at_s + 1.0, 3)
        at_s += 1.0 + looked_s
        changes += driver.advance(ns(at_s))
    assert [change.value for change in changes] == [holds("ok", "scan"), None]
    assert changes[1].time_ns / ns(1.0) == pytest.approx(3.0 + settling_s, abs=1.0 + looked_s)
    assert values(beat(driver, "scan", at_s, 30)) == ["ok(scan)"]


def test_a_short_lapse_only_puts_ticks_off() -> None:
    driver = Driver([GeneralObserver("scan", RATE), NodeObserver(["n"], Table(lifetime_s=0.3))], 0)
    beat(driver, "scan", 0, 20)  # the last one at 1.9 s
    driver.sample(PROCESSES, ns(1.9), ["n"], ns(1.9))
    driver.advance(ns(1.96))
    assert driver.lapse(ns(2.25)) == []
    for _ in range(3):  # what waited meanwhile
        assert values(driver.sample("scan", ns(2.25), now_ns=ns(2.25))) == []
    # The topic would have been silent at 2.4 s; the table ran out at 2.2 s, and a new one is waited for.
    assert [(c.time_ns, c.value) for c in driver.advance(ns(9))] == [
        (ns(2.75), fails("ok", "scan")),
        (ns(2.76), None),
    ]


def test_what_is_to_be_judged_anew_in_a_lapse_is_judged_from_the_end_of_the_lapse() -> None:
    driver = Driver([GeneralObserver("scan", RATE)], 0)
    beat(driver, "scan", 0, 20)  # the last one at 1.9 s
    driver.lapse(ns(4.0))
    assert driver.settle(7, [SCAN]) == []
    assert values(driver.advance(ns(4.3))) == []  # silent for more than a second, if somebody had looked
    (again,) = beat(driver, "scan", 4.3, 8)
    assert (again.value, again.settled) == (holds("ok", "scan"), 7)


# --- nobody looks ------------------------------------------------------------------------------------------


def test_what_a_feed_does_not_look_at_is_unknown_after_a_second_and_never_silent() -> None:
    driver = Driver([GeneralObserver("scan", RATE), GeneralObserver("odom", RATE)], 0)
    for k in range(20):
        for topic in ("scan", "odom"):
            driver.sample(topic, ns(k / 10), now_ns=ns(k / 10))
    assert driver.sample("scan", ns(1.95), Contact.LOST, ns(1.95)) == []
    changes = [*driver.advance(ns(60))]
    odom = Atom("ok", ("odom",))
    assert [(c.atom, c.value) for c in changes] == [(odom, -Literal(odom)), (SCAN, None)]
    assert ns(2.9) < changes[1].time_ns < ns(3.1)
    assert driver.sample("scan", ns(61), Contact.LOST, ns(61)) == ()  # it is known
    driver.sample("scan", ns(62), Contact.BACK, ns(62))
    assert values(beat(driver, "scan", 62.1, 20)) == ["ok(scan)"]


def test_of_what_a_feed_looks_at_again_silence_counts_from_then() -> None:
    driver = Driver([GeneralObserver("scan", RATE)], 0)
    beat(driver, "scan", 0, 20)
    driver.sample("scan", ns(2), Contact.LOST, ns(2))
    driver.advance(ns(30))
    driver.sample("scan", ns(30), Contact.BACK, ns(30))
    (silent,) = driver.advance(ns(31))
    assert (silent.time_ns, silent.value, silent.since_ns) == (ns(30.5), fails("ok", "scan"), ns(30))


def test_a_feed_that_was_away_for_a_moment_changes_no_verdict() -> None:
    driver = Driver([GeneralObserver("scan", RATE)], 0)
    beat(driver, "scan", 0, 20)
    driver.sample("scan", ns(2), Contact.LOST, ns(2))
    assert driver.advance(ns(2.7)) == []
    assert values(beat(driver, "scan", 2.7, 20)) == []  # a sample shows that somebody looks
    assert driver.standing()[0].since_ns >= ns(2.7)


def test_time_that_nobody_looked_at_and_that_is_told_afterwards_is_no_silence() -> None:
    driver = Driver([GeneralObserver("scan", RATE)], 0)
    beat(driver, "scan", 0, 20)
    assert driver.sample("scan", ns(2.3), Contact.BACK, ns(2.3)) == []
    assert driver.advance(ns(2.75)) == []
    assert values(driver.advance(ns(3))) == ["not ok(scan)"]


def test_an_observer_of_two_sources_needs_both_of_them() -> None:
    driver = Driver([BinaryQualitativeObserver("matched(x,y)", "a:x", "a:y")], 0)
    driver.sample("a:y", 0, Contact.LOST, 0)
    for k in range(200):
        assert driver.sample("a:x", ns(k / 10), 1.0, ns(k / 10)) in ((), [])
    driver.sample("a:y", ns(20), Contact.BACK, ns(20))
    changes = [c for k in range(200, 300) for s in ("a:x", "a:y")
               for c in driver.sample(s, ns(k / 10), 1.0, ns(k / 10))]  # fmt: skip
    assert values(changes) == ["matched(x,y)"]


def test_who_asks_for_a_verdict_of_what_nobody_looks_at_hears_that_there_is_none() -> None:
    driver = Driver([GeneralObserver("scan", RATE)], 0)
    beat(driver, "scan", 0, 20)
    driver.sample("scan", ns(2), Contact.LOST, ns(2))
    driver.advance(ns(5))
    driver.settle(7, [SCAN])
    assert [(c.value, c.settled) for c in driver.advance(ns(20))] == [(None, 7)]


def test_after_a_lapse_of_three_settling_times_all_is_unknown_at_once() -> None:
    driver = Driver([GeneralObserver("scan", RATE)], 0)
    beat(driver, "scan", 0, 20)
    until_ns = ns(2 + CHANCES * driver.delays_s(SCAN)[1])
    driver.lapse(until_ns)
    changes = [*driver.advance(until_ns + ns(0.1))]
    assert [change.value for change in changes] == [None]


# --- what is no number ------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_none_is_left_out_of_every_observer_of_its_source_and_told_once(
    value: float,
) -> None:
    told: list[ObserverProblem] = []
    observers: list[Observer] = [
        PropertyObserver("low", "a:x", Band(high=5)),
        QualitativeObserver("x", "a:x", Trend(check_s=0)),
        FunctionObserver(lambda x: x < 5, "mine", "a:x"),
        BinaryQualitativeObserver("matched(x,y)", "a:x", "a:y"),
    ]
    driver = Driver(observers, 0, on_problem=told.append)
    for k in range(21):
        driver.sample("a:x", ns(k / 10), 1.0, ns(k / 10))
    before = {str(verdict.literal) for verdict in driver.standing()}
    assert {"ok(low)", "const(x)", "ok(mine)"} <= before
    for k in range(3):
        assert driver.sample("a:x", ns(2.01 + k / 100), value, ns(2.01 + k / 100)) == ()
    assert {str(verdict.literal) for verdict in driver.standing()} == before
    assert [(problem.what, problem.where) for problem in told] == [("number", "a:x")]
    assert "a sample of a:x is no number" in told[0].message
    assert driver.problems.counts["number", "a:x"] == 3 * len(observers)


# --- observers that raise ---------------------------------------------------------------------------------


def test_an_observer_that_raises_is_told_once_with_its_place_and_the_others_go_on() -> None:
    problems: list[ObserverProblem] = []
    driver = Driver(
        [Told("a"), Told("a", Atom("ok", ("other",))), Told("b", Atom("ok", ("b",)))],
        0,
        on_problem=problems.append,
    )
    driver.sample("a", 1, 1)
    assert values(driver.sample("a", 2, "boom")) == ["None", "None"]
    assert values(driver.sample("b", 3, 1)) == ["ok(b)"]
    driver.sample("a", 4, "boom")
    (problem,) = problems
    assert inspect.getsourcefile(Told) in problem.where.split(":")
    assert "Told of ok(scan) failed: RuntimeError: boom" in problem.message
    assert values(driver.sample("a", 5, 1)) == ["ok(scan)", "ok(other)"]  # it may come to its senses


@pytest.mark.parametrize("method", ["check", "due_ns", "evidence", "reset"])
def test_whatever_it_raises_in_the_others_go_on(method: str) -> None:
    class Broken(Told):
        pass

    def broken(*_: object) -> None:
        raise ZeroDivisionError

    driver_of = Broken("a")
    setattr(Broken, method, broken)
    driver = Driver([driver_of, Told("b", Atom("ok", ("b",)))], 0)
    assert values(driver.sample("a", 1, 1)) in ([], ["None"], ["ok(scan)"])
    assert values(driver.sample("b", 2, 1)) == ["ok(b)"]
    driver.settle(1, [SCAN])
    driver.advance(ns(100))
    assert [str(v.literal) for v in driver.standing()][-1] == "ok(b)"
    assert sum(driver.problems.counts.values()) < 250  # it is not asked a hundred times a second
