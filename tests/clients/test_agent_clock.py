"""An agent whose computer's clock is set while it runs: what its batches say."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from tests.clients.service_double import ServiceDouble, eventually, service_double
from tests.clients.talker import watching
from tests.wrong_clock import WrongClock

MINUTES_NS = 600 * 10**9


def newest(service: ServiceDouble) -> dict[str, Any]:
    """Return the newest batch on the topic."""
    return next((batch for batch in reversed(service.batches()) if batch["observations"]), {})


def test_an_agents_stamps_follow_its_clock_ahead_and_go_on_when_it_is_set_back(tmp_path: Path) -> None:
    clock = WrongClock(tmp_path)
    scan = {"tolerance_hz": 8, "silence_s": 10}  # the talker may be late, on a busy computer
    with (
        service_double() as service,
        watching(tmp_path, service.url, clock.environment, topics={"scan": scan}) as (_, talker),
    ):

        def since_ns() -> int:
            return int(newest(service)["since"][0]) if newest(service) else 0

        talker.say("scan")
        eventually(lambda: service.holds().get("ok(scan)"), "ok(scan)")
        well = len(service.batches())
        right_ns = time.time_ns()
        clock.set(600)
        eventually(lambda: since_ns() > right_ns + MINUTES_NS, "evidence by the new time")
        clock.set(0)
        back_ns = since_ns()
        eventually(lambda: since_ns() > back_ns + 2 * 10**9, "evidence that goes on from there")
        clock.set(-600)
        before_ns = since_ns()
        eventually(lambda: since_ns() > before_ns + 10**9, "evidence that goes on from there")
    said = [literal for batch in service.batches()[well:] for literal in batch["observations"]]
    assert set(said) == {"ok(scan)"}  # a clock is no silence
    times = [batch["time"] for batch in service.batches()]
    assert times == sorted(times)
    for batch in service.batches():
        for begun_ns in batch.get("since", ()):
            assert begun_ns <= batch["time"]
    log = (tmp_path / "agent.log").read_text()
    assert log.count("the clock was set ahead by") == 1
    assert "the clock went back" not in log
