"""The board is pure: these tests tell it the time."""

from __future__ import annotations

import pytest

from robomend.board.codec import Code
from robomend_board.board import TRIP_S, Board
from robomend_board.faults import Fault, parse_fault
from robomend_board.loads import Load, Rig, Supply, default_rig

QUIET = Rig(Supply(24.0, 0.0), (Load("lamp", 1.5), Load("motor", 3.0, 9.0, 0.1), Load()))


@pytest.mark.parametrize(
    ("channel", "state", "code"),
    [
        (0, 1, Code.OK),
        (0, 0, Code.OK),
        (3, 1, Code.UNKNOWN_CHANNEL),
        (0, 2, Code.BAD_VALUE),
        (9, 9, Code.UNKNOWN_CHANNEL),
    ],
)
def test_switching_is_acknowledged_with_a_code(channel: int, state: int, code: Code) -> None:
    assert Board(QUIET).switch(channel, state, 0.0) is code


def test_switching_on_twice_changes_nothing_and_brings_no_second_inrush() -> None:
    board = Board(QUIET)
    board.switch(1, 1, 0.0)
    assert board.switch(1, 1, 10.0) is Code.OK
    assert board.measure(10.0).channels[1].current_a == pytest.approx(3.0)


def test_inrush_decays_to_the_steady_current() -> None:
    board = Board(QUIET)
    board.switch(1, 1, 100.0)
    currents = [board.measure(100.0 + t).channels[1].current_a or 0.0 for t in (0.0, 0.1, 0.2, 2.0)]
    assert currents == sorted(currents, reverse=True)
    assert currents[0] == pytest.approx(9.0)
    assert currents[-1] == pytest.approx(3.0)


def test_the_same_seed_gives_the_same_noise() -> None:
    def run(seed: int) -> list[object]:
        board = Board(default_rig(10), on=range(8), seed=seed)
        return [board.measure(t / 10) for t in range(20)]

    assert run(1) == run(1)
    assert run(1) != run(2)


@pytest.mark.parametrize("closed", [True, False])
def test_a_stuck_relay_stays_where_it_is_and_says_so(closed: bool) -> None:
    board = Board(QUIET, on=[0] if closed else [])
    board.set_fault(Fault("stuck", 0), 0.0)
    assert board.switch(0, int(closed), 1.0) is Code.OK
    assert board.switch(0, int(not closed), 1.0) is Code.CHANNEL_FAULTY
    assert board.measure(1.0).channels[0].on is closed
    board.clear_fault("stuck", 0, 2.0)
    assert board.switch(0, int(not closed), 2.0) is Code.OK


def test_an_open_cable_has_voltage_but_no_current_and_powers_nothing() -> None:
    board = Board(QUIET, on=[0])
    board.set_fault(Fault("open", 0), 0.0)
    lamp = board.measure(0.0).channels[0]
    assert (lamp.on, lamp.current_a) == (True, 0.0)
    assert lamp.voltage_v == pytest.approx(24.0, abs=0.1)
    assert not board.states(0.0)[0].powered


def test_a_short_draws_too_much_and_then_trips() -> None:
    board = Board(QUIET, on=[0])
    board.set_fault(Fault("short", 0), 5.0)
    assert board.next_trip_s() == pytest.approx(5.0 + TRIP_S)
    assert (board.measure(5.0 + TRIP_S / 2).channels[0].current_a or 0.0) > 10.0
    assert not board.measure(5.0 + TRIP_S).channels[0].on
    assert board.next_trip_s() is None


def test_a_welded_relay_does_not_trip() -> None:
    board = Board(QUIET, on=[0])
    board.set_fault(Fault("stuck", 0), 0.0)
    board.set_fault(Fault("short", 0), 0.0)
    assert board.measure(60.0).channels[0].on


@pytest.mark.parametrize(
    ("load", "trips"),
    [
        (Load("fine", 3.0, 9.0, 0.1), False),
        (Load("surge", 3.0, 11.0, 0.1), False),  # above 10 A for 13 ms
        (Load("long", 3.0, 30.0, 0.2), True),
        (Load("steady", 11.0), True),
    ],
)
def test_a_load_trips_its_channel_only_if_it_exceeds_the_limit_for_long(load: Load, trips: bool) -> None:
    board = Board(Rig(Supply(24.0, 0.0), (load,)))
    board.switch(0, 1, 0.0)
    assert (board.next_trip_s() is not None) is trips
    assert board.measure(1.0).channels[0].on is not trips


def test_a_brown_out_starves_devices_below_their_least_voltage_with_the_relays_on() -> None:
    board = Board(QUIET, on=[0, 1])
    board.set_fault(parse_fault({"fault": "brown-out", "volts": 17}, 3), 0.0)
    lamp = board.measure(0.0).channels[0]
    assert (lamp.on, lamp.current_a) == (True, 0.0)
    assert lamp.voltage_v == pytest.approx(17.0, abs=0.1)
    assert [state.powered for state in board.states(0.0)] == [False, False, False]
    board.clear_fault("brown-out", None, 1.0)
    assert [state.powered for state in board.states(1.0)] == [True, True, False]
