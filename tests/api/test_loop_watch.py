"""The watch asks the event loop for signs, and looks at no frames but where none comes."""

from __future__ import annotations

import sys
import time
from types import FrameType

import anyio
import pytest
import uvloop
from structlog.testing import capture_logs

from robomend.api.loop_watch import HELD_S, LoopWatch
from robomend.metrics import Metrics


@pytest.mark.parametrize("held", [False, True])
def test_frames_are_looked_at_where_the_loop_is_held_only(
    held: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked: list[float] = []
    frames = sys._current_frames

    def counted() -> dict[int, FrameType]:
        looked.append(time.monotonic())
        return frames()

    async def main() -> None:
        metrics = Metrics()
        watch = LoopWatch(metrics)
        monkeypatch.setattr(sys, "_current_frames", counted)
        watch.start()
        with anyio.fail_after(60):
            while sum(metrics.loop_delay_s.counts) < 5 or (held and not looked):
                if held:
                    time.sleep(5 * HELD_S)  # the loop is held: that is what is tested
                await anyio.sleep(0.01)
        watch.close()

    with capture_logs() as logs:
        uvloop.run(main())
    told = [one for one in logs if one["event"] == "event loop held"]
    assert len(looked) <= len(told) + 1  # of the last one the watch may have ended before it was told
    assert bool(looked) or not held
