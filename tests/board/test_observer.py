"""Measurements become literals; silence becomes nothing."""

from __future__ import annotations

from robomend.board.codec import ChannelReading
from robomend.board.observer import HardwareObserver, Wiring
from robomend.board.snapshot import Snapshot
from robomend_client.literals import fails, holds

SECOND = 1_000_000_000
JAGUAR = {"jaguar": Wiring(7, expected_current_a=3.0, tolerance_a=0.5)}


def snapshot(time_s: float, *, on: bool = True, current_a: float | None = 3.0) -> Snapshot:
    idle = ChannelReading(False, 0.0, 0.0)
    return Snapshot(round(time_s * SECOND), (*(idle,) * 7, ChannelReading(on, current_a, 24.0), idle, idle))


def test_a_channel_that_is_on_gives_on_and_one_that_is_off_gives_not_on() -> None:
    observer = HardwareObserver({"jaguar": Wiring(7), "hokuyo": Wiring(3)})
    assert observer.observe(snapshot(0)) == {holds("on", "jaguar"), fails("on", "hokuyo")}


def test_silence_is_unknown_and_gives_nothing() -> None:
    observer = HardwareObserver(JAGUAR)
    observer.observe(snapshot(0))
    assert observer.observe(Snapshot(SECOND, None, "silent")) == frozenset()


def test_a_channel_that_the_board_does_not_have_gives_nothing() -> None:
    observer = HardwareObserver({"arm": Wiring(12)})
    assert observer.observe(snapshot(0)) == frozenset()


def test_a_current_is_judged_after_it_settled_and_three_readings_agree() -> None:
    observer = HardwareObserver(JAGUAR)
    seen = [observer.observe(snapshot(at)) for at in (0.0, 0.4, 0.6, 0.8, 1.0)]
    assert seen[:4] == [{holds("on", "jaguar")}] * 4
    assert seen[4] == {holds("on", "jaguar"), holds("ok", "current", "jaguar")}
    assert str(holds("ok", "current", "jaguar")) == "ok(current,jaguar)"


def test_inrush_is_no_fault() -> None:
    observer = HardwareObserver(JAGUAR)
    inrush = [observer.observe(snapshot(at / 10, current_a=9.0)) for at in range(5)]
    settled = [observer.observe(snapshot(0.5 + at / 10)) for at in range(5)]
    assert not any(fails("ok", "current", "jaguar") in literals for literals in (*inrush, *settled))
    assert holds("ok", "current", "jaguar") in settled[-1]


def test_an_open_load_is_not_ok_and_a_spike_is() -> None:
    observer = HardwareObserver(JAGUAR)
    for at in range(10):
        observer.observe(snapshot(at))
    assert holds("ok", "current", "jaguar") in observer.observe(snapshot(10, current_a=9.0))
    assert holds("ok", "current", "jaguar") in observer.observe(snapshot(11))
    opened = [observer.observe(snapshot(12 + at, current_a=0.0)) for at in range(3)]
    assert holds("ok", "current", "jaguar") in opened[1]
    assert opened[2] == {holds("on", "jaguar"), fails("ok", "current", "jaguar")}


def test_the_edge_of_the_tolerance_is_still_ok() -> None:
    observer = HardwareObserver(JAGUAR, settle_s=0, agreeing=1)
    assert holds("ok", "current", "jaguar") in observer.observe(snapshot(0, current_a=3.5))
    assert fails("ok", "current", "jaguar") in observer.observe(snapshot(1, current_a=3.75))


def test_nothing_is_said_of_the_current_of_a_channel_that_is_off_or_of_a_sensor_that_fails() -> None:
    observer = HardwareObserver(JAGUAR, settle_s=0, agreeing=1)
    assert observer.observe(snapshot(0, on=False, current_a=0.0)) == {fails("on", "jaguar")}
    assert observer.observe(snapshot(1, current_a=None)) == {holds("on", "jaguar")}


def test_switching_on_again_starts_the_judgement_anew() -> None:
    observer = HardwareObserver(JAGUAR, agreeing=1)
    observer.observe(snapshot(0))
    assert holds("ok", "current", "jaguar") in observer.observe(snapshot(1))
    observer.observe(snapshot(2, on=False, current_a=0.0))
    assert observer.observe(snapshot(3, current_a=9.0)) == {holds("on", "jaguar")}


def test_the_tolerance_is_a_quarter_of_the_current_unless_given() -> None:
    assert Wiring(0, 2.0).band_a == 0.5
    assert Wiring(0, 0.1).band_a == 0.05
    assert Wiring(0, 2.0, 0.1).band_a == 0.1


def test_after_silence_the_current_is_judged_anew() -> None:
    observer = HardwareObserver(JAGUAR, agreeing=1)
    observer.observe(snapshot(0))
    assert holds("ok", "current", "jaguar") in observer.observe(snapshot(1))
    observer.observe(Snapshot(2 * SECOND, None, "silent"))
    assert observer.observe(snapshot(3, current_a=9.0)) == {holds("on", "jaguar")}
