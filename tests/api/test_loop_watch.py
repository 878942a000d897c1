"""The event loop gives signs; its watch looks at no frames but where none comes, and tells of that."""

from __future__ import annotations

import sys
import time
from collections.abc import MutableMapping
from types import FrameType
from typing import Any

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

    def told() -> list[MutableMapping[str, Any]]:
        return [one for one in logs if one["event"] == "event loop held"]

    async def main() -> None:
        metrics = Metrics()
        watch = LoopWatch(metrics)
        monkeypatch.setattr(sys, "_current_frames", counted)
        watch.start()
        with anyio.fail_after(60):
            while sum(metrics.loop_delay_s.counts) < 5 or (held and not told()):
                if held:
                    time.sleep(5 * HELD_S)  # the loop is held: that is what is tested
                await anyio.sleep(0.01)
        watch.close()

    with capture_logs() as logs:
        uvloop.run(main())
    assert len(looked) <= len(told()) + 1  # of the last one the watch may have ended before it was told
    for one in told():
        assert one["ms"] >= 1000 * HELD_S
        assert one["processor_ms"] <= one["ms"]
        assert one["where"]
