"""The computer's clock is set: what comes afterwards is newer all the same, also after a restart."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import pytest
from tests.api.conftest import TEDUSAR, bad_sets
from tests.api.test_process import served
from tests.forked import popen
from tests.waiting import until
from tests.wrong_clock import WrongClock

HOUR_S, DAY_S = 3600, 24 * 3600
DAY_NS = DAY_S * 10**9


class Robot:
    """A robot of a service that lives by a clock of the test's."""

    def __init__(self, url: str, log: Path) -> None:
        self._http = httpx.Client(base_url=f"{url}/api/v1", timeout=60)
        self._log = log

    def make(self) -> None:
        assert self._http.put("/models/tedusar", json={"source": TEDUSAR}).status_code == 201
        assert self._http.put("/robots/r1", json={"model": "tedusar"}).status_code == 201

    def observe(self, *said: str, **more: Any) -> httpx.Response:
        return self._http.post("/robots/r1/observations", json={"observations": list(said), **more})

    def changed(self, *said: str, **more: Any) -> list[str]:
        changed: list[str] = self.observe(*said, **more).json()["changed"]
        return changed

    def blamed(self) -> list[set[str]]:
        return bad_sets(self._http.get("/robots/r1/diagnosis", params={"after": 1, "wait_s": 20}).json())

    @property
    def jumps(self) -> int:
        """How often the service has said that a clock jumped."""
        return self._log.read_text().count("clock jumped")


@contextmanager
def robot_by(clock: WrongClock, folder: Path) -> Iterator[Robot]:
    with served(folder, start=partial(popen, env=clock.environment)) as (_, url):
        yield Robot(url, folder / "log")


@pytest.mark.parametrize("restarted", [False, True])
def test_what_is_observed_after_the_clock_went_back_counts(restarted: bool, tmp_path: Path) -> None:
    clock = WrongClock(tmp_path)

    def goes_back(robot: Robot) -> None:
        assert robot.changed("not ok(scan)", lifetime_s=600.0) == ["not ok(scan)"]
        assert robot.blamed() == [{"hokuyo"}, {"hokuyo_node"}]

    with robot_by(clock, tmp_path) as robot:
        robot.make()
        robot.observe("ok(scan)", "ok(map)")
        clock.set(-HOUR_S)
        if not restarted:
            goes_back(robot)
    if restarted:
        with robot_by(clock, tmp_path) as robot:
            goes_back(robot)


@pytest.mark.parametrize("restarted", [False, True])
def test_after_it_was_a_day_ahead_correct_stamps_count_again(restarted: bool, tmp_path: Path) -> None:
    clock = WrongClock(tmp_path, DAY_S)

    def right_again(robot: Robot) -> None:
        now = time.time_ns()
        stamps = {"time": now, "since": [now - 10**9], "lifetime_s": 600.0}
        assert robot.changed("not ok(scan)", **stamps) == ["not ok(scan)"]
        assert robot.blamed() == [{"hokuyo"}, {"hokuyo_node"}]
        assert robot.changed("ok(scan)", time=time.time_ns()) == ["ok(scan)"]
        assert robot.changed("not ok(scan)", time=now - 10**9) == []  # what is older is older still
        ahead = robot.observe("ok(odom)", time=time.time_ns() + 120 * 10**9)
        assert ahead.status_code == 422
        assert " s ahead of this service's clock" in ahead.json()["detail"]
        assert robot.jumps == 1

    with robot_by(clock, tmp_path) as robot:
        robot.make()
        robot.observe("ok(scan)", "ok(map)")  # without a time: by the service's clock
        clock.set(0)
        if not restarted:
            right_again(robot)
    if restarted:
        with robot_by(clock, tmp_path) as robot:
            right_again(robot)


def test_an_agents_clock_that_goes_on_from_a_day_ahead_as_ours_does_is_no_fault(tmp_path: Path) -> None:
    clock = WrongClock(tmp_path, DAY_S)
    with robot_by(clock, tmp_path) as robot:
        robot.make()
        robot.observe("ok(scan)", "ok(map)")
        clock.set(0)
        assert robot.changed("not ok(scan)", time=time.time_ns() + DAY_NS) == ["not ok(scan)"]


def test_a_source_that_is_a_day_behind_is_followed_when_that_is_sure(tmp_path: Path) -> None:
    with robot_by(WrongClock(tmp_path), tmp_path) as robot:
        robot.make()
        robot.observe("not ok(scan)")

        def say(sentence: str) -> list[str]:
            """Say it as a robot does whose clock is a day behind."""
            stamps = {"time": time.time_ns() - DAY_NS, "source": "lidar", "lifetime_s": 600.0}
            return robot.changed(sentence, **stamps)

        until(lambda: say("ok(scan)") == ["ok(scan)"], "its news are never heard", 60.0)
        assert say("not ok(scan)") == ["not ok(scan)"]
        assert robot.jumps == 1
