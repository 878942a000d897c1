"""The watch lets an event loop that waits sleep on, and asks one that is at something."""

from __future__ import annotations

import time

import anyio
import pytest
import uvloop

from robomend.api.loop_watch import ASKED_EACH, LoopWatch
from robomend.metrics import Metrics

ENOUGH = 5 * ASKED_EACH


@pytest.mark.parametrize(
    ("busy", "asked"), [(False, range(1, ENOUGH // 2)), (True, range(ENOUGH // 2, 10**6))]
)
def test_a_loop_that_waits_is_seldom_asked(busy: bool, asked: range) -> None:
    signs: list[float] = []

    class Watch(LoopWatch):
        def _give_sign(self) -> None:
            signs.append(time.monotonic())
            super()._give_sign()

    async def main() -> None:
        metrics = Metrics()
        watch = Watch(metrics)
        watch.start()
        with anyio.fail_after(60):
            while sum(metrics.loop_delay_s.counts) < ENOUGH:
                if busy:
                    time.sleep(0.03)  # the loop is held: that is what is tested
                    await anyio.sleep(0)
                else:
                    await anyio.sleep(1.0)  # the loop waits: that is what is tested
        watch.close()

    uvloop.run(main())
    assert len(signs) in asked
