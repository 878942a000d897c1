"""The agent's observers and its clock."""

from __future__ import annotations

import asyncio
import logging
import time
from contextlib import suppress

import pytest

from robomend_client.agent.watch import Watch
from robomend_client.clock import Clock
from robomend_client.observers import SECOND, Change, GeneralObserver, Rate


def test_a_clock_that_is_set_ahead_is_told_also_while_the_agent_was_late(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    wall_ns, mono_ns = [1_800_000_000 * SECOND], [SECOND]
    monkeypatch.setattr(time, "time_ns", lambda: wall_ns[0])
    monkeypatch.setattr(time, "monotonic_ns", lambda: mono_ns[0])
    watch = Watch([GeneralObserver("scan")], Clock(), lambda changes: None)

    def later(by_s: float, set_ahead_s: float = 0.0) -> None:
        mono_ns[0] += round(by_s * SECOND)
        wall_ns[0] += round((by_s + set_ahead_s) * SECOND)
        watch.standing()

    with caplog.at_level(logging.DEBUG, "robomend_client.agent.watch"):
        later(0.05)
        later(5.0)  # nobody looked
        later(5.0, set_ahead_s=600.0)
        later(0.05, set_ahead_s=60.0)
    assert [(record.levelname, record.message) for record in caplog.records] == [
        ("DEBUG", "nobody looked for 5.00 s"),
        ("WARNING", "the clock was set ahead by 600.0 s"),
        ("WARNING", "the clock was set ahead by 60.0 s"),
    ]


class Computer:
    """Its clocks; it may be elsewhere for a while after each look at one of them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.passed_ns = SECOND
        self.held_ns = 0
        monkeypatch.setattr(time, "time_ns", lambda: 1_800_000_000 * SECOND + self.look())
        monkeypatch.setattr(time, "monotonic_ns", self.look)

    def look(self) -> int:
        passed_ns = self.passed_ns
        self.passed_ns += self.held_ns
        return passed_ns


def test_a_clock_that_is_held_up_in_the_middle_of_a_look_does_not_go_ahead(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    computer = Computer(monkeypatch)
    clock = Clock()
    for held_ns in (SECOND // 2, 0):
        computer.held_ns = held_ns
        assert 0 <= clock.now_ns() - 1_800_000_000 * SECOND <= computer.passed_ns
    assert clock.ahead_ns == 0


def test_an_agent_that_is_held_up_in_the_middle_of_a_look_does_not_say_that_the_clock_was_set(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    computer = Computer(monkeypatch)
    watch = Watch([GeneralObserver("scan")], Clock(), lambda changes: None)
    with caplog.at_level(logging.DEBUG, "robomend_client.agent.watch"):
        for held_ns in (0, SECOND // 2, 0, 0):
            computer.held_ns = held_ns
            watch.standing()
    assert {record.levelname for record in caplog.records} == {"DEBUG"}  # it says that nobody looked


def test_what_has_come_by_now_is_taken_in_before_anything_is_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    wall_ns = [1_800_000_000 * SECOND]
    monkeypatch.setattr(time, "time_ns", lambda: wall_ns[0])
    monkeypatch.setattr(time, "monotonic_ns", lambda: wall_ns[0])
    changes: list[Change] = []
    sleeps: list[float] = []

    class Waiting:
        """A topic at 10 Hz whose newest message waits until it is read."""

        def read_now(self) -> None:
            watch.sample("scan", None, wall_ns[0] - SECOND // 100)

    async def passing(seconds: float) -> None:
        """Time passes, nothing else happens."""
        sleeps.append(seconds)
        if len(sleeps) == 20:
            raise asyncio.CancelledError
        wall_ns[0] += SECOND // 10

    # Silence is due before the next sample is read: it was there before that.
    watch = Watch([GeneralObserver("scan", Rate(10, silence_s=0.105))], Clock(), changes.extend)
    watch.read(Waiting(), ["scan"])
    monkeypatch.setattr(asyncio, "sleep", passing)
    with suppress(asyncio.CancelledError):
        asyncio.run(watch.run())
    assert len(sleeps) == 20
    assert [str(change.value) for change in changes] == ["ok(scan)"]


def test_a_feed_that_cannot_be_read_is_told_once_and_the_others_are_read_on(
    caplog: pytest.LogCaptureFixture,
) -> None:
    class Reading:
        reads = 0

        def read_now(self) -> None:
            self.reads += 1

    class Broken(Reading):
        def read_now(self) -> None:
            super().read_now()
            raise ZeroDivisionError("mine")

    broken, good = Broken(), Reading()
    watch = Watch([GeneralObserver("scan")], Clock(), lambda changes: None)
    watch.read(broken, ["scan"])
    watch.read(good, [])
    for n in range(3):
        watch.settle(n, ())
    assert (broken.reads, good.reads) == (1, 3)
    assert [record.message for record in caplog.records] == [
        "the feed Broken failed, and is not read any more"
    ]
