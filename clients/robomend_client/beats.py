"""Waiting for a beat: what is looked at now and then is looked at together.

    beat           |    |    |    |    |    |    |     each BEAT_S, by the computer's clock
    observers      x    x    x    x    x    x    x
    processes        ──► x    ──► x    ──► x           each 0.1 s
    master                   ──────────────────► x     each second

To wake up costs an idle computer as much as to take in ten messages. So whoever looks at something each so
often waits until the beat that is nearest to the end of its period, and is woken with the others.
"""

from __future__ import annotations

import asyncio
import time
from typing import Any

SLICES = 4

BEAT_S = 0.05
BEAT_NS = 50_000_000


def until_beat_s(period_s: float, now_ns: int) -> float:
    """Return how long it is until the beat that is nearest to the end of a period, the next one at least."""
    beats = max(now_ns // BEAT_NS + 1, (now_ns + round(period_s * 1e9) + BEAT_NS // 2) // BEAT_NS)
    return (beats * BEAT_NS - now_ns) / 1e9


async def beat(period_s: float = BEAT_S) -> None:
    """Wait for about a period, until a beat."""
    await asyncio.sleep(until_beat_s(period_s, time.time_ns()))


async def done_within(task: asyncio.Task[Any], timeout_s: float) -> bool:
    """Wait for a task; return whether it is done in time.

    It is waited for in parts: of an agent that was itself halted meanwhile, one part runs out at once, and
    the answer that waits in the socket is read before the next.
    """
    for _ in range(SLICES):
        await asyncio.wait({task}, timeout=timeout_s / SLICES)
        if task.done():
            return True
    return False
