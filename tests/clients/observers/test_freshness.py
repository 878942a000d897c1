"""Values that stand still, and stamps that are old, of messages that come at their rate."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from tests.clients.observers.driving import values

from robomend_client.literals import Atom
from robomend_client.observers import Change, Driver, ns
from robomend_client.observers.freshness import (
    STAMP,
    Age,
    AgeObserver,
    ChangingObserver,
    Stillness,
    suggested,
)
from robomend_client.readings import Symptom

T0 = 1_700_000_000
MOVES, AGE = Atom("ok", ("moves", "imu")), Atom("ok", ("age", "scan"))


def beat(
    driver: Driver, source: str, value: Callable[[float], object], from_s: float, to_s: float, hz: float = 10
) -> list[Change]:
    changes: list[Change] = []
    for n in range(round((to_s - from_s) * hz)):
        at_s = from_s + n / hz
        changes += driver.advance(ns(T0 + at_s))
        changes += driver.sample(source, ns(T0 + at_s), value(at_s), ns(T0 + at_s))
    return changes


def imu(stillness: Stillness | None = None) -> Driver:
    return Driver([ChangingObserver("ok(moves,imu)", "imu:z", stillness)], ns(T0))


def test_of_an_array_that_stands_still_the_first_numbers_are_shown() -> None:
    driver = imu()
    beat(driver, "imu:z", lambda t: [t, 2.0], 0, 20)
    beat(driver, "imu:z", lambda t: [2.0062029361724854, 2.0, *[1.5] * 18], 20, 40)
    assert str(driver.standing()[0].reading).startswith("z stands still at 2.006, 2, 1.5 and 17 more since ")


@pytest.mark.parametrize("value", [lambda t: [1.0, 2.0, t], lambda t: f"{t:.1f}", lambda t: int(10 * t)])
def test_lists_and_texts_change_too(value: Callable[[float], object]) -> None:
    driver = imu()
    assert values(beat(driver, "imu:z", value, 0, 15)) == ["ok(moves,imu)"]
    assert values(beat(driver, "imu:z", lambda t: value(15), 15, 30)) == ["not ok(moves,imu)"]


def test_what_differs_by_less_than_the_tolerance_has_not_changed() -> None:
    driver = imu(Stillness(tolerance=0.1))
    assert values(beat(driver, "imu:z", lambda t: 0.05 * (round(10 * t) % 2), 0, 15)) == ["not ok(moves,imu)"]


def test_a_value_that_does_not_come_stands_nowhere() -> None:
    driver = imu()
    beat(driver, "imu:z", lambda t: 0.42, 0, 15)
    assert [one.value for one in driver.advance(ns(T0 + 21))] == [None]
    assert values(beat(driver, "imu:z", lambda t: 0.42, 30, 39)) == []  # nobody knows what it was meanwhile
    assert values(beat(driver, "imu:z", lambda t: 0.42, 39, 41)) == ["not ok(moves,imu)"]


def test_one_jump_after_a_reset_is_no_sign_of_life() -> None:
    driver = imu()
    beat(driver, "imu:z", lambda t: 0.42, 0, 15)
    driver.settle(1, [MOVES])
    assert beat(driver, "imu:z", lambda t: 0.42 if t < 16 else 0.0, 15, 25.9) == []
    (found,) = beat(driver, "imu:z", lambda t: 0.0, 25.9, 30)
    assert (str(found.value), found.settled) == ("not ok(moves,imu)", 1)


def stamp(behind_s: float) -> Callable[[float], object]:
    return lambda t: {"sec": int(T0 + t - behind_s), "nanosec": int((t - behind_s) % 1 * 1e9)}


@pytest.mark.parametrize(
    ("behind_s", "told"),
    [
        (-4, "stamp 4 s ahead"),
        (200, "stamp 3 min behind"),
    ],
)
def test_a_stamp_that_is_old_is_a_fault_and_says_by_how_much(behind_s: float, told: str) -> None:
    driver = Driver([AgeObserver("ok(age,scan)")], ns(T0))
    assert values(beat(driver, f"scan:{STAMP}", stamp(0.1), 0, 5)) == ["ok(age,scan)"]
    (bad,) = beat(driver, f"scan:{STAMP}", stamp(behind_s), 5, 8)
    assert str(bad.value) == "not ok(age,scan)"
    assert (bad.time_ns - ns(T0 + 5)) / 1e9 <= 0.4
    assert bad.reading is not None
    assert bad.reading.symptom is Symptom.OLD
    assert str(bad.reading) == f"{told}, at most 2 s"
    assert values(beat(driver, f"scan:{STAMP}", stamp(0.1), 8, 10)) == ["ok(age,scan)"]


def test_one_late_message_is_none() -> None:
    driver = Driver([AgeObserver("ok(age,scan)")], ns(T0))
    late = lambda t: stamp(9 if round(10 * t) % 5 == 0 else 0)(t)  # noqa: E731  # as the others are
    assert values(beat(driver, f"scan:{STAMP}", late, 0, 5)) == ["ok(age,scan)"]


def test_stamps_of_no_clock_say_nothing() -> None:
    driver = Driver([AgeObserver("ok(age,scan)", expected=Age(most_s=1))], ns(T0))
    assert beat(driver, f"scan:{STAMP}", lambda t: {"sec": int(t), "nanosec": 0}, 0, 5) == []
    assert suggested("/scan", {STAMP: {"sec": 12, "nanosec": 0}}) == {}
    assert suggested("/scan", {STAMP: {"sec": T0, "nanosec": 0}}) == {
        "ok(age,scan)": {"kind": "age", "topic": "scan"}
    }
