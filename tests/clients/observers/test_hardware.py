"""The hardware observer: measurements become literals; silence becomes nothing."""

from __future__ import annotations

from typing import NamedTuple

import pytest

from robomend_client.literals import Atom, Literal, fails, holds
from robomend_client.observers import BOARD, BoardReadings, Evidence, HardwareObserver, Wiring, ns


class Channel(NamedTuple):
    """A channel as the service's board link has it."""

    on: bool
    current_a: float | None
    voltage_v: float


JAGUAR = {"jaguar": Wiring(7, expected_current_a=3.0, tolerance_a=0.5)}
CURRENT = Atom("ok", ("current", "jaguar"))


class Board:
    """An observer, and the measurements that it gets."""

    def __init__(self, wiring: dict[str, Wiring], settle_s: float = 0.5, agreeing: int = 3) -> None:
        self.observer = HardwareObserver(wiring, BoardReadings(settle_s=settle_s, agreeing=agreeing))

    def measure(self, time_s: float, *, on: bool = True, current_a: float | None = 3.0) -> set[Literal]:
        """Return what is said after a measurement of channel 7; the others are off."""
        idle = Channel(False, 0.0, 0.0)
        channels = (*(idle,) * 7, Channel(on, current_a, 24.0), idle, idle)
        self.observer.feed(BOARD, ns(time_s), channels)
        return set(self.observer.check(ns(time_s)))


def test_a_current_is_judged_after_it_settled_and_three_readings_agree() -> None:
    board = Board(JAGUAR)
    seen = [board.measure(at) for at in (0.0, 0.4, 0.6, 0.8, 1.0)]
    assert seen[:4] == [{holds("on", "jaguar")}] * 4
    assert seen[4] == {holds("on", "jaguar"), holds("ok", "current", "jaguar")}
    assert str(holds("ok", "current", "jaguar")) == "ok(current,jaguar)"


def test_an_open_load_is_not_ok_and_a_spike_is() -> None:
    board = Board(JAGUAR)
    for at in range(10):
        board.measure(at)
    assert holds("ok", "current", "jaguar") in board.measure(10, current_a=9.0)
    assert holds("ok", "current", "jaguar") in board.measure(11)
    opened = [board.measure(12 + at, current_a=0.0) for at in range(3)]
    assert holds("ok", "current", "jaguar") in opened[1]
    assert opened[2] == {holds("on", "jaguar"), fails("ok", "current", "jaguar")}


def test_nothing_is_said_of_the_current_of_a_channel_that_is_off_or_of_a_sensor_that_fails() -> None:
    board = Board(JAGUAR, settle_s=0, agreeing=1)
    assert board.measure(0, on=False, current_a=0.0) == {fails("on", "jaguar")}
    assert board.measure(1, current_a=None) == {holds("on", "jaguar")}


def test_a_board_that_says_nothing_more_is_unknown_after_the_lifetime() -> None:
    board = Board({"jaguar": Wiring(7)})
    board.measure(1)
    assert board.observer.due_ns() == ns(4)
    assert board.observer.check(ns(3.9)) == (holds("on", "jaguar"),)
    assert board.observer.check(ns(4)) == ()


def test_verdicts_rest_on_measurements_and_began_after_the_last_good_one() -> None:
    board = Board(JAGUAR, settle_s=0)
    for at in range(6):
        board.measure(at, current_a=3.0 if at < 3 else 9.0)
    assert board.observer.evidence(Atom("on", ("jaguar",)), ns(5))[:2] == Evidence(ns(5))[:2]
    assert board.observer.evidence(CURRENT, ns(5))[:2] == Evidence(ns(3), ns(2))[:2]
    board.measure(6, on=False)
    assert board.observer.evidence(Atom("on", ("jaguar",)), ns(6))[:2] == Evidence(ns(6), ns(5))[:2]


def test_what_is_no_list_of_channels_is_refused() -> None:
    with pytest.raises(TypeError, match="a list of channels is needed"):
        HardwareObserver({"a": Wiring(0)}).feed(BOARD, 0, "on")
