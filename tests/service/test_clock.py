"""The computer's clock is set back: what comes afterwards is newer all the same, also after a restart."""

from __future__ import annotations

import time
from typing import Any

import pytest
from tests.api.conftest import Service, StartService, bad_sets
from tests.api.conftest import start as start  # the fixture
from tests.waiting import until

from robomend.robots.clock import ServiceClock
from robomend_client.clock import Clock

HOUR_NS = 3600 * 10**9
DAY_NS = 24 * HOUR_NS

ROOMS = ("clock", "batches", "robot", "diagnosing", "robots", "sight")
"""Modules of robomend.robots that know the service's clock."""


def with_a_clock_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the services of this process use a new clock, as after a restart."""
    fresh = ServiceClock()
    for room in ROOMS:
        monkeypatch.setattr(f"robomend.robots.{room}.CLOCK", fresh)


def set_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the computer's clock an hour back from now on."""
    real = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: real() - HOUR_NS)


def test_it_never_goes_back_and_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    made = Clock()
    before = made.now_ns()
    set_back(monkeypatch)
    readings = [made.now_ns() for _ in range(100)]
    assert readings == sorted(readings)
    assert before <= readings[0] < before + HOUR_NS
    assert readings[-1] > readings[0]


def test_it_follows_the_computers_clock_ahead(monkeypatch: pytest.MonkeyPatch) -> None:
    made = Clock()
    real = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: real() + HOUR_NS)
    assert made.now_ns() >= real() + HOUR_NS // 2


@pytest.mark.parametrize("restarted", [False, True])
def test_what_is_observed_after_the_clock_went_back_counts(
    start: StartService, monkeypatch: pytest.MonkeyPatch, restarted: bool
) -> None:
    first = start()
    first.with_robot()
    first.observe("ok(scan)", "ok(map)")
    set_back(monkeypatch)
    service = first
    if restarted:
        with_a_clock_of_its_own(monkeypatch)
        service = start()
    answer = service.observe("not ok(scan)", lifetime_s=600.0)
    assert answer.json()["changed"] == ["not ok(scan)"]
    assert bad_sets(service.diagnosis(after=1, wait_s=20)) == [{"hokuyo"}, {"hokuyo_node"}]


def begun_a_day_ahead(start: StartService, monkeypatch: pytest.MonkeyPatch) -> Service:
    """Return a service that began while the computer's clock was a day ahead; it is right again."""
    real = time.time_ns
    with monkeypatch.context() as ahead:
        ahead.setattr(time, "time_ns", lambda: real() + DAY_NS)
        with_a_clock_of_its_own(monkeypatch)
        service = start()
        service.with_robot()
        service.observe("ok(scan)", "ok(map)")  # without a time: by the service's clock
    return service


@pytest.mark.parametrize("restarted", [False, True])
def test_after_it_was_a_day_ahead_correct_stamps_count_again(
    start: StartService, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], restarted: bool
) -> None:
    real = time.time_ns
    service = begun_a_day_ahead(start, monkeypatch)
    if restarted:
        with_a_clock_of_its_own(monkeypatch)
        service = start()
    now = real()
    answer = service.observe("not ok(scan)", time=now, since=[now - 10**9], lifetime_s=600.0)
    assert answer.json()["changed"] == ["not ok(scan)"]
    assert bad_sets(service.diagnosis(after=1, wait_s=20)) == [{"hokuyo"}, {"hokuyo_node"}]
    assert service.observe("ok(scan)", time=real()).json()["changed"] == ["ok(scan)"]
    late = service.observe("not ok(scan)", time=now - 10**9)  # what is older is older still
    assert late.json()["changed"] == []
    ahead_of_it = service.observe("ok(odom)", time=real() + 120 * 10**9)
    assert ahead_of_it.status_code == 422
    assert " s ahead of this service's clock" in ahead_of_it.json()["detail"]
    assert capsys.readouterr().err.count("clock jumped") == 1


def test_an_agents_clock_that_goes_on_from_a_day_ahead_as_ours_does_is_no_fault(
    start: StartService, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = time.time_ns
    service = begun_a_day_ahead(start, monkeypatch)
    answer = service.observe("not ok(scan)", time=real() + DAY_NS)
    assert answer.json()["changed"] == ["not ok(scan)"]


def test_a_source_that_is_a_day_behind_is_followed_when_that_is_sure(
    start: StartService, capsys: pytest.CaptureFixture[str]
) -> None:
    service = start()
    service.with_robot()
    service.observe("not ok(scan)")

    def say(sentence: str) -> list[str]:
        """Say it as a robot does whose clock is a day behind."""
        body: dict[str, Any] = {"time": time.time_ns() - DAY_NS, "source": "lidar", "lifetime_s": 600.0}
        changed: list[str] = service.observe(sentence, **body).json()["changed"]
        return changed

    until(lambda: say("ok(scan)") == ["ok(scan)"], "its news are never heard", 60.0)
    assert say("not ok(scan)") == ["not ok(scan)"]
    assert capsys.readouterr().err.count("clock jumped") == 1
