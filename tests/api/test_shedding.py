"""What could not be answered in time is refused at once; the stop and health are not."""

from __future__ import annotations

import math
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import httpx
import pytest
from tests.api.conftest import StartService
from tests.waiting import until

from robomend.api import shedding
from robomend.api.problems import Problem
from robomend.api.shedding import (
    ALWAYS,
    BURST_S,
    CALM_S,
    HANGS_S,
    MEANWHILE_S,
    MOST_S,
    TARGET_S,
    LoadShedding,
)
from robomend.metrics import Metrics
from robomend.store import Transaction


class Times:
    """The clock, the queue's age and the loop's delay, as a test sets them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = self.oldest_s = self.late_s = 0.0
        monkeypatch.setattr(time, "perf_counter", lambda: self.now_s)
        monkeypatch.setattr(time, "monotonic", lambda: self.now_s)
        self.made = LoadShedding(lambda: self.oldest_s, lambda: self.late_s, Metrics())

    def refuses(self) -> bool:
        """Whether a batch is refused that comes now."""
        problem = self.made.refusal()
        assert problem is None or (problem.status, problem.code) == (503, "overloaded")
        return problem is not None

    def overload(self) -> bool:
        """Whether a batch is refused that comes now, and one that comes when no burst would last so long."""
        now_s, refused = self.now_s, self.refuses()
        self.now_s += BURST_S + 0.01
        refused = self.refuses() or refused
        self.now_s = now_s
        return refused

    def serve(self, count: int, place_s: float) -> None:
        """Have so many batches, one after another, which take this long for each place in the queue."""
        for _ in range(count):
            with self.made.one():
                self.now_s += place_s


@pytest.fixture
def times(monkeypatch: pytest.MonkeyPatch) -> Times:
    return Times(monkeypatch)


def test_as_many_are_let_in_as_are_answered_in_time(times: Times) -> None:
    for place_s in (0.004, 0.001, 0.010):  # however fast the disk is just now
        times.serve(2000, place_s)
        with ExitStack() as under_way:
            count = 0
            while not times.overload():
                count += 1
                under_way.enter_context(times.made.one())
            times.now_s += CALM_S + 0.1
            assert count == pytest.approx(max(ALWAYS, TARGET_S / place_s), rel=0.1)


def test_a_queue_that_is_shared_is_measured_by_its_places(times: Times) -> None:
    """Ten that wait for one another take ten times as long each, and are no slower for that."""
    for _ in range(200):
        with ExitStack() as together:
            for _ in range(10):
                together.enter_context(times.made.one())
            times.now_s += 0.010
    assert times.made.delay_s == 0
    with times.made.one():
        assert times.made.delay_s == pytest.approx(0.010 * 10 / 55, rel=0.1)  # 1 + 2 + … + 10 places


def test_a_few_are_always_let_in_so_that_the_measure_stays_current(times: Times) -> None:
    times.serve(2000, 60.0)
    with ExitStack() as under_way:
        for _ in range(ALWAYS):
            assert not times.refuses()
            under_way.enter_context(times.made.one())
        assert times.refuses()


def test_a_burst_passes_and_one_that_would_wait_for_too_long_does_not(times: Times) -> None:
    times.serve(2000, 0.010)
    with ExitStack() as under_way:
        while times.made.delay_s < (TARGET_S + MOST_S) / 2:
            under_way.enter_context(times.made.one())
        assert not times.refuses()
        times.now_s += BURST_S / 2
        assert not times.refuses()
        times.now_s += BURST_S
        assert times.refuses()
        times.now_s += CALM_S + 0.1  # that one is over; this is another
        assert not times.refuses()
        while not times.refuses():
            under_way.enter_context(times.made.one())
        assert times.made.delay_s == pytest.approx(MOST_S, rel=0.1)


def test_a_loop_that_is_late_counts_into_the_delay(times: Times) -> None:
    times.serve(2000, 0.001)
    with ExitStack() as under_way:
        for _ in range(ALWAYS):
            under_way.enter_context(times.made.one())
        assert not times.overload()
        times.late_s = TARGET_S
        assert times.overload()


def test_a_disk_that_hangs_lets_nobody_in(times: Times) -> None:
    times.oldest_s = HANGS_S + 0.1
    assert times.refuses()
    times.oldest_s = 0.0
    assert not times.refuses()


def test_a_batch_that_took_long_to_read_is_asked_about_once_more(times: Times) -> None:
    times.oldest_s = HANGS_S + 0.1
    with times.made.one(0.0):  # the edge has just let it in
        pass
    for since_s in (2 * MEANWHILE_S, math.inf):
        with pytest.raises(Problem), times.made.one(since_s):
            pass
    assert times.made.under_way == 0


@pytest.mark.parametrize("content_type", ["application/json", "application/json; charset=utf-8"])
def test_while_the_disk_hangs_batches_are_503_at_once_and_the_stop_is_set(
    start: StartService, monkeypatch: pytest.MonkeyPatch, content_type: str
) -> None:
    service = start()
    service.with_robot()
    release, hung = threading.Event(), threading.Event()
    where = f"{service.url}/api/v1/robots/r1/observations"

    def hang(_: Transaction) -> None:
        hung.set()
        release.wait(60)

    def post() -> httpx.Response:
        body, headers = b'{"observations": ["not ok(scan)"]}', {"Content-Type": content_type}
        return httpx.post(where, content=body, headers=headers, timeout=60)

    async def begin() -> None:
        waiting.append(service.loop.create_task(service.runtime.store.write(hang)))

    waiting: list[object] = []
    # What is queued behind it waits for as long as this machine takes to let the next one in.
    monkeypatch.setattr(shedding, "HANGS_S", 60.0)
    with ThreadPoolExecutor(1) as clients:
        try:
            service.run(begin())
            assert hung.wait(30)
            accepted = clients.submit(post)  # it was let in before anybody could know
            until(lambda: service.runtime.parts.shedding.under_way > 0, "it was not let in")
            monkeypatch.setattr(shedding, "HANGS_S", 0.1)
            until(lambda: service.runtime.store.oldest_queued_s() > 0.1, "nothing waits")
            refused = post()
            assert (refused.status_code, refused.json()["code"]) == (503, "overloaded")
            assert int(refused.headers["retry-after"]) >= 1
            stopped = httpx.post(f"{service.url}/api/v1/stop", json={"reason": "smoke"}, timeout=60)
            assert (stopped.status_code, stopped.json()["active"]) == (202, True)
            assert httpx.get(f"{service.url}/healthz", timeout=60).status_code == 200
            metrics = service.http.get("/metrics").text
            assert 'robomend_refused_total{limit="overload"} 1.0' in metrics
        finally:
            release.set()
        assert accepted.result(60).json()["revision"] == 1
    monkeypatch.undo()
    until(lambda: post().status_code == 200, "it does not accept again")
