"""Several observers that speak of one atom."""

from __future__ import annotations

import pytest
from tests.clients.observers.driving import Told, values

from robomend_client.literals import fails, holds
from robomend_client.observers import Driver, Verdict, ns


@pytest.mark.parametrize(
    ("said", "together"),
    [
        ([1, 1], "ok(scan)"),
        ([1, 0], "not ok(scan)"),
        ([0, 0], "not ok(scan)"),
        ([None, 1], "ok(scan)"),
        ([None, 0], "not ok(scan)"),
    ],
)
def test_bad_news_wins_and_who_does_not_know_has_no_vote(said: list[object], together: str) -> None:
    driver = Driver([Told("a"), Told("b")], 0)
    changes = [*driver.sample("a", 1, said[0]), *driver.sample("b", 2, said[1])]
    assert values(changes)[-1] == together


def test_what_all_say_rests_on_all_and_bad_news_on_the_youngest() -> None:
    driver = Driver([Told("a"), Told("b")], 0)
    driver.sample("a", 10, 1)
    driver.sample("b", 20, 1)
    assert driver.standing() == [Verdict(holds("ok", "scan"), 10)]
    driver.sample("a", 30, 0)
    driver.sample("b", 40, 0)
    assert driver.standing() == [Verdict(fails("ok", "scan"), 40)]


def test_what_was_measured_goes_with_the_verdict_and_is_renewed_with_it() -> None:
    driver = Driver([Told("a", reads=True), Told("b", reads=True), Told("c")], 0)
    assert [str(change.reading) for change in driver.sample("a", 10, 0)] == ["a said 0"]
    assert not driver.sample("b", 20, 0)
    driver.sample("c", 30, 0)
    assert [str(verdict.reading) for verdict in driver.standing()] == [
        "b said 0"
    ]  # the youngest that has one
    (good,) = [*driver.sample("a", 40, 1), *driver.sample("b", 50, 1), *driver.sample("c", 60, 1)]
    assert (good.value, str(good.reading)) == (holds("ok", "scan"), "b said 1")


def test_two_observers_that_swap_at_one_tick_do_not_flicker() -> None:
    class Ticking(Told):
        def __init__(self, source: str) -> None:
            super().__init__(source)
            self.period_ns = ns(1)

    driver = Driver([Ticking("a"), Ticking("b")], 0)
    driver.sample("a", ns(0.1), 0, ns(0.1))
    driver.sample("b", ns(0.2), 1, ns(0.2))
    assert values(driver.advance(ns(1))) == ["not ok(scan)"]
    driver.sample("a", ns(1.1), 1, ns(1.1))
    driver.sample("b", ns(1.2), 0, ns(1.2))
    assert values(driver.advance(ns(2))) == []
