"""Waiting for a beat: what is looked at now and then is looked at together.

    beat           |    |    |    |    |    |    |     each BEAT_S, by the computer's clock
    observers      x    x    x    x    x    x    x
    processes        ──► x    ──► x    ──► x           each 0.1 s
    master                   ──────────────────► x     each second

To wake up costs an idle computer as much as to take in ten messages. So whoever looks at something each so
often waits until the beat that is nearest to the end of its period, and is woken with the others.

Who is woken late, again and again, is on a computer that has more to do than it can (`Lateness`). What others
do there is late as well, so that it is late is then no sign that they are at fault.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any

SLICES = 4

BEAT_S = 0.05
BEAT_NS = 50_000_000


def until_beat_s(period_s: float, now_ns: int) -> float:
    """Return how long it is until the beat that is nearest to the end of a period, the next one at least."""
    beats = max(now_ns // BEAT_NS + 1, (now_ns + round(period_s * 1e9) + BEAT_NS // 2) // BEAT_NS)
    return (beats * BEAT_NS - now_ns) / 1e9


async def beat(period_s: float = BEAT_S) -> float:
    """Wait for about a period, until a beat; return by how many seconds it was late."""
    wait_s, began_s = until_beat_s(period_s, time.time_ns()), time.monotonic()
    await asyncio.sleep(wait_s)
    return max(0.0, time.monotonic() - began_s - wait_s)


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


MOST_LATE = 0.2
"""Part of the time: a process that is late, or waits for a processor, for more of it is starved. Beside as
many busy loops as there are processors it is 0.05; where ten processes want each of them, 0.3 to 0.9."""

LATE_SPAN_S, LATE_LEAST_S = 2.0, 0.5
STARVED_FOR_S = 3.0
"""It counts as starved until so long after it was last seen to be."""

SCHEDULED = Path("/proc/self/schedstat")
"""Of the main thread: nanoseconds on a processor, and nanoseconds for which it waited for one."""


class Lateness:
    """Whether the main thread of this process is kept from its work: by others that want the processors, by a
    limit of its container, by signals that halt it, or as it has too much to do itself.
    """

    def __init__(self, most: float = MOST_LATE) -> None:
        self._most = most
        self._late_s = 0.0
        self._seen: deque[tuple[float, float, float]] = deque()  # when, late until then, waited until then
        self._starved_until_s = float("-inf")

    def look(self, late_s: float) -> bool:
        """Return whether it is starved now; it was woken so late just now."""
        now_s = time.monotonic()
        self._late_s += late_s
        seen = self._seen
        seen.append((now_s, self._late_s, self._waited_s()))
        while now_s - seen[0][0] > LATE_SPAN_S and len(seen) > 2:
            seen.popleft()
        span_s = now_s - seen[0][0]
        if span_s >= LATE_LEAST_S:
            most_s = max(seen[-1][1] - seen[0][1], seen[-1][2] - seen[0][2])
            if most_s > self._most * span_s:
                self._starved_until_s = now_s + STARVED_FOR_S
        return now_s < self._starved_until_s

    @staticmethod
    def _waited_s() -> float:
        with suppress(OSError, LookupError, ValueError):  # a kernel may not count it
            return int(SCHEDULED.read_bytes().split()[1]) / 1e9
        return 0.0
