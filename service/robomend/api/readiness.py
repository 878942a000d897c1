"""Whether this instance can serve requests, and what is wrong where it cannot; told at once, always.

store      it reads and writes; failing or hanging is not ready
queue      how long the oldest write waits
loop       how late the event loop comes to new tasks
workers    there are some to be had
boards     shown; one robot's fault makes nobody unready
"""

from __future__ import annotations

import asyncio

from robomend.api.deps import Parts
from robomend.api.loop_watch import LoopWatch
from robomend.api.schemas.operation import Check, Readiness
from robomend.api.store_probe import ANSWER_S

QUEUE_AGE_S = 2.0
"""Of the oldest write, beyond which clients had better go elsewhere."""

DELAY_S = 1.0
"""Of the event loop."""


async def readiness(parts: Parts) -> Readiness:
    """Look at each part that requests need; for any event loop, and also while the service's own is held."""
    loop = parts.watch.loop
    if asyncio.get_running_loop() is loop:
        return await _readiness(parts)
    asking = asyncio.run_coroutine_threadsafe(_readiness(parts), loop)
    waiting = asyncio.wrap_future(asking)
    await asyncio.wait({waiting}, timeout=ANSWER_S + 0.02)
    if waiting.done():
        return waiting.result()
    asking.cancel()
    check = _loop(parts.watch)
    return Readiness(ready=check.ok, checks={"loop": check})


async def _readiness(parts: Parts) -> Readiness:
    figures = parts.store.figures()
    checks = {
        "store": await parts.probe.check(),
        "queue": Check(
            ok=figures.oldest_write_s <= QUEUE_AGE_S,
            detail=f"{figures.queued_writes} writes wait, the oldest for {figures.oldest_write_s:.1f} s",
        ),
        "loop": _loop(parts.watch),
        "workers": Check(ok=parts.one_shots.alive, detail=""),
    }
    ready = all(check.ok for check in checks.values()) and not parts.hub.closing
    return Readiness(ready=ready, checks={**checks, "boards": _boards(parts)})


def _loop(watch: LoopWatch) -> Check:
    delay_s = watch.delay_s
    return Check(ok=delay_s <= DELAY_S, detail=f"{delay_s * 1000:.0f} ms late")


def _boards(parts: Parts) -> Check:
    boards = parts.robots.boards.states()
    away = sorted(robot for robot, state in boards.items() if state != "connected")
    named = f": {', '.join(away[:10])}" if away else ""
    return Check(ok=not away, detail=f"{len(away)} of {len(boards)} not connected{named}")
