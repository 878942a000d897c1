"""Robots in memory are bounded; what is held of one is never lost or there twice."""

from __future__ import annotations

import asyncio
import gc
from concurrent.futures import Future

from tests.api.conftest import Service, StartService, bad_sets
from tests.api.conftest import start as start  # the fixture


def in_memory(service: Service) -> int:
    """Return how many robots are in memory, by the service's own count."""

    async def count() -> int:
        gc.collect()  # a timer that has run may be in a cycle with its robot
        lines = (await service.runtime.metrics.text()).decode().splitlines()
        return int(float(next(line for line in lines if line.startswith("robomend_robots ")).split()[1]))

    found: int = service.run(count())
    return found


def test_idle_robots_make_room_and_come_back_as_they_were(start: StartService) -> None:
    service = start(max_robots=5)
    for number in range(30):
        service.with_robot(f"r{number}")
        service.observe("not ok(scan)" if number % 2 else "ok(scan)", robot=f"r{number}")
    assert in_memory(service) <= 6  # one may be in the hands of what was just done
    for number in range(30):
        found = service.diagnosis(f"r{number}")
        assert found["revision"] == 1
        assert bad_sets(found) == ([{"hokuyo"}, {"hokuyo_node"}] if number % 2 else [set()])
        assert service.observe("not ok(map)", robot=f"r{number}").json()["revision"] == 2
    assert in_memory(service) <= 6


def test_who_waits_for_a_robot_keeps_it_and_is_told(start: StartService) -> None:
    service = start(max_robots=1)
    service.with_robot("waited")

    async def wait() -> int:
        state = await service.runtime.robots.memory.robot("waited")
        return await state.changed(0, 60.0)

    waiting: Future[int] = asyncio.run_coroutine_threadsafe(wait(), service.loop)
    for number in range(5):
        service.with_robot(f"r{number}")
        service.observe("ok(scan)", robot=f"r{number}")
    service.observe("ok(scan)", robot="waited")
    assert waiting.result(60) == 1


def test_what_grows_stale_is_diagnosed_though_nobody_asked_since(start: StartService) -> None:
    service = start(max_robots=1)
    service.with_robot("timed")
    service.observe("not ok(scan)", robot="timed", lifetime_s=5.0)
    revisions = []
    with service.http.stream("GET", "/api/v1/robots/timed/events") as stream:
        lines = stream.iter_lines()
        next(lines)
        service.with_robot("other")
        service.observe("ok(scan)", robot="other")
        for line in lines:
            if line.startswith("event: diagnosis"):
                revisions.append(line)
                break
    assert revisions


def test_a_period_keeps_its_robot(start: StartService) -> None:
    service = start(max_robots=1)
    service.with_robot("periodic", period_s=0.2)
    for number in range(3):
        service.with_robot(f"r{number}")
    assert in_memory(service) >= 2

    async def held() -> bool:
        gc.collect()
        return "periodic" in service.runtime.robots.memory.states

    assert service.run(held())
