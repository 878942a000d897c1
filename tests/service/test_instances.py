"""Two services on one database: what one takes in, the other knows."""

from __future__ import annotations

import asyncio
import time
from concurrent.futures import Future

from tests.api.conftest import StartService, bad_sets
from tests.api.conftest import start as start  # the fixture

from robomend.custody.hearing import LiveSight


def test_who_waits_for_observations_hears_of_those_of_another_instance(start: StartService) -> None:
    one, two = start(), start()
    one.with_robot()
    one.observe("ok(scan)")
    assert two.diagnosis(after=0, wait_s=10)["revision"] == 1
    fleet = two.runtime.fleet

    async def wait() -> int:
        state = await fleet.latest("r1")
        return await LiveSight(fleet, state).changed(1, 20.0)

    waiting: Future[int] = asyncio.run_coroutine_threadsafe(wait(), two.loop)
    time.sleep(0.2)
    began = time.monotonic()
    one.observe("not ok(scan)")
    assert waiting.result(20) == 2
    assert time.monotonic() - began < 15  # woken, not timed out


def test_either_instance_serves_what_the_other_was_told(start: StartService) -> None:
    one, two = start(), start()
    one.with_robot()
    for number in range(10):
        told, asked = (one, two) if number % 2 else (two, one)
        told.observe("not ok(scan)" if number % 2 else "ok(scan)")
        found = asked.diagnosis(after=number, wait_s=10)
        assert found["revision"] == number + 1
        assert bad_sets(found) == ([{"hokuyo"}, {"hokuyo_node"}] if number % 2 else [set()])
