"""The watch says where the event loop was held; only the loop's own thread looks at its frames."""

from __future__ import annotations

import asyncio
import gc
import sys
import time
from collections.abc import Callable
from typing import Any

import anyio
import pytest
import uvloop
from starlette.types import Receive, Scope, Send
from structlog.testing import capture_logs
from tests.api.conftest import StartService
from tests.waiting import until

from robomend.api.edge import Edge
from robomend.api.loop_watch import HELD_S, LoopWatch
from robomend.metrics import Metrics


@pytest.fixture(params=[uvloop.run, asyncio.run], ids=["uvloop", "asyncio"])
def run(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Callable[[Any], Any]:
    """Both loops: they have their own ways with signals."""

    def broken() -> None:
        raise AssertionError("frames of other threads are looked at, which may end the process")

    monkeypatch.setattr(sys, "_current_frames", broken)
    run: Callable[[Any], Any] = request.param
    return run


def in_bytecode() -> None:
    end = time.monotonic() + 5 * HELD_S
    while time.monotonic() < end:
        pass


def in_a_call() -> None:
    time.sleep(5 * HELD_S)  # the loop is held: that is what is tested


@pytest.mark.parametrize("hold", [in_bytecode, in_a_call])
def test_where_the_loop_is_held_is_told(hold: Callable[[], None], run: Callable[[Any], Any]) -> None:
    async def main() -> None:
        watch = LoopWatch(Metrics())
        watch.start()
        with anyio.fail_after(60):
            while not any(hold.__name__ in told["where"] for told in held(logs)):
                hold()
                await anyio.sleep(0.01)
        watch.close()

    with capture_logs() as logs:
        run(main())
    assert all(told["processor_ms"] <= told["ms"] >= HELD_S * 1000 for told in held(logs))


def test_what_is_done_with_each_sign_is_seen_in_how_late_the_next_one_is() -> None:
    done: list[float] = []

    def slowly() -> None:
        done.append(time.monotonic())
        in_a_call()

    async def main() -> None:
        watch = LoopWatch(Metrics(), slowly)
        watch.start()
        with anyio.fail_after(60):
            while not any("in_a_call" in told["where"] for told in held(logs)):
                await anyio.sleep(0.01)
        watch.close()

    with capture_logs() as logs:
        asyncio.run(main())
    assert len(done) > 1


def test_a_service_has_its_young_objects_looked_at(start: StartService) -> None:
    start()
    before = gc.get_stats()[0]["collections"]
    gc.disable()  # nobody else has it done
    try:
        until(lambda: gc.get_stats()[0]["collections"] > before, "nobody looked")
    finally:
        gc.enable()


def test_the_request_is_told_that_holds_the_loop() -> None:
    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        in_a_call()

    async def main() -> None:
        metrics = Metrics()
        edge = Edge(app, metrics=metrics, express=None, shedding=None)
        watch = LoopWatch(metrics)
        watch.start()
        with anyio.fail_after(60):
            while not any(told["where"].endswith("; PUT /api/v1/models/m") for told in held(logs)):
                scope = {"type": "http", "method": "PUT", "path": "/api/v1/models/m", "headers": []}
                await edge(scope, nothing, nothing)
                await anyio.sleep(0.01)
        watch.close()

    async def nothing(*_: object) -> Any:
        pass

    with capture_logs() as logs:
        uvloop.run(main())


def test_nothing_is_looked_at_while_the_loop_turns(
    run: Callable[[Any], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    looked: list[object] = []
    look = LoopWatch._look

    def counted(*given: Any) -> None:
        looked.append(given)
        look(*given)

    monkeypatch.setattr(LoopWatch, "_look", counted)

    async def main() -> None:
        metrics = Metrics()
        watch = LoopWatch(metrics)
        watch.start()
        with anyio.fail_after(60):
            while sum(metrics.loop_delay_s.counts) < 5:
                await anyio.sleep(0.01)
        watch.close()

    with capture_logs() as logs:
        run(main())
    assert len(looked) <= len(held(logs)) + 1  # of the last one the watch may have ended before it was told


def held(logs: list[Any]) -> list[Any]:
    return [one for one in logs if one["event"] == "event loop held"]
