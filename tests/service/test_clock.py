"""The computer's clock is set back: what comes afterwards is newer all the same, also after a restart."""

from __future__ import annotations

import time

import pytest
from tests.api.conftest import StartService, bad_sets
from tests.api.conftest import start as start  # the fixture

from robomend_client.clock import Clock

HOUR_NS = 3600 * 10**9


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
        fresh = Clock()
        for room in ("clock", "batches", "robot", "diagnosing", "robots"):
            monkeypatch.setattr(f"robomend.robots.{room}.CLOCK", fresh)
        service = start()
    answer = service.observe("not ok(scan)", lifetime_s=600.0)
    assert answer.json()["changed"] == ["not ok(scan)"]
    assert bad_sets(service.diagnosis(after=1, wait_s=20)) == [{"hokuyo"}, {"hokuyo_node"}]
