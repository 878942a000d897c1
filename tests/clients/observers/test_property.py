"""The property observer, and how readings become a verdict that lasts."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend_client.literals import Atom, fails, holds
from robomend_client.observers import (
    Band,
    Driver,
    Evidence,
    FunctionObserver,
    NoNumber,
    PropertyObserver,
    Readings,
    ns,
)
from robomend_client.observers.base import WrongKind

CPU = Atom("ok", ("CPU", "laser"))


def observer(band: Band, **readings: float) -> PropertyObserver:
    return PropertyObserver("ok(CPU,laser)", "cpu", band, Readings(**readings))  # type: ignore[arg-type]  # agreeing


def signs(o: PropertyObserver, *values: float) -> list[bool | None]:
    """Feed one value a second; return what is said after each."""
    said = []
    for second, value in enumerate(values):
        o.feed("cpu", ns(second), value)
        literals = o.check(ns(second))
        said.append(literals[0].positive if literals else None)
    return said


def test_what_is_no_number_is_no_reading() -> None:
    o = observer(Band(high=1))
    assert signs(o, 0.5) == [True]
    for value in (math.nan, math.inf, 10**400):
        with pytest.raises(NoNumber):
            o.feed("cpu", ns(1), value)
    assert o.check(ns(1)) == (holds("ok", "CPU", "laser"),)
    with pytest.raises(WrongKind, match="a number is needed, not 'hot'"):
        o.feed("cpu", ns(9), "hot")


def test_a_verdict_rests_on_the_readings_that_agree_and_began_after_the_last_good_one() -> None:
    o = observer(Band(high=1), agreeing=2)
    signs(o, 0, 0, 0, 2, 2, 2)
    assert o.check(ns(5)) == (fails("ok", "CPU", "laser"),)
    assert o.evidence(CPU, ns(5))[:2] == Evidence(ns(4), ns(2))[:2]
    assert observer(Band(high=1), debounce_s=2).detection_s == 3


@given(
    st.lists(st.tuples(st.integers(0, 3), st.booleans()), max_size=40), st.integers(1, 4), st.integers(0, 5)
)
def test_verdicts_follow_their_definition(
    readings: list[tuple[int, bool]], agreeing: int, debounce_s: int
) -> None:
    o = observer(Band(high=0.5), agreeing=agreeing, debounce_s=debounce_s, lifetime_s=100)
    expected, seen, second = None, list[tuple[int, bool]](), 0
    for gap, good in readings:
        second += gap
        o.feed("cpu", ns(second), 0.0 if good else 1.0)
        seen.append((second, good))
        streak = [
            at for k, (at, was) in enumerate(seen) if all(w is good for _, w in seen[k:]) and was is good
        ]
        if len(streak) >= agreeing and second - streak[0] >= debounce_s:
            expected = good
        assert [literal.positive for literal in o.check(ns(second))] == (
            [] if expected is None else [expected]
        )


def test_what_was_read_once_of_a_latched_topic_is_kept_over_resets_and_does_not_age() -> None:
    kept = PropertyObserver("grid", "map:resolution", Band(high=0.1), Readings(latched=True))
    mine = FunctionObserver(lambda v: v < 0.1, "mine", "map:resolution", Readings(latched=True))
    driver = Driver([kept, mine], 0)
    driver.sample("map:resolution", ns(1), 0.05, ns(1))
    for n in (1, 2):
        changes = [*driver.settle(n, driver.atoms), *driver.advance(driver.now_ns + ns(3600))]
        assert [(str(c.value), c.settled) for c in changes] == [("ok(grid)", n), ("ok(mine)", n)]
        # It confirms nothing that was done since: it is as old as it is.
        assert {c.since_ns for c in changes} == {ns(1)}
    driver.lapse(driver.now_ns + ns(3600))
    driver.advance(driver.now_ns + ns(7200))
    assert {str(verdict.literal) for verdict in driver.standing()} == {"ok(grid)", "ok(mine)"}
    assert [str(c.value) for c in driver.sample("map:resolution", driver.now_ns, 0.5, driver.now_ns)] == [
        "not ok(grid)",
        "not ok(mine)",
    ]


@pytest.mark.parametrize("latched", [True, False])
def test_what_waited_while_nobody_looked_is_taken_in_of_a_latched_topic_only(latched: bool) -> None:
    kept = PropertyObserver("grid", "map:resolution", Band(high=0.1), Readings(latched=latched))
    driver = Driver([kept], 0)
    driver.sample("map:resolution", ns(1), 0.05, ns(1))
    driver.lapse(ns(20.3))  # it was halted, and what comes until then has waited
    driver.advance(ns(20.1))
    driver.sample("map:resolution", ns(20.1), 0.5, ns(20.1))
    driver.advance(ns(30))
    said = [str(verdict.literal) for verdict in driver.standing()]
    assert said == (["not ok(grid)"] if latched else [])
