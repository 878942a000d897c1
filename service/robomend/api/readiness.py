"""Whether this instance can serve requests, and what is wrong where it cannot."""

from __future__ import annotations

import asyncio

from robomend.api.deps import Parts
from robomend.api.schemas.operation import Check, Readiness
from robomend.errors import RobomendError
from robomend.store import global_stop

STORE_TIMEOUT_S = 2.0


async def readiness(parts: Parts) -> Readiness:
    """Look at each part that requests need. A robot's board is shown,
    but one robot's fault makes nobody unready.
    """
    checks = {"store": await _store(parts), "workers": Check(ok=parts.one_shots.alive, detail="")}
    boards = parts.robots.board_states()
    away = sorted(robot for robot, state in boards.items() if state != "connected")
    checks["boards"] = Check(
        ok=not away,
        detail=f"{len(away)} of {len(boards)} not connected" + (f": {', '.join(away[:10])}" if away else ""),
    )
    ready = checks["store"].ok and checks["workers"].ok and not parts.hub.closing
    return Readiness(ready=ready, checks=checks)


async def _store(parts: Parts) -> Check:
    try:
        async with asyncio.timeout(STORE_TIMEOUT_S):
            await parts.store.read(global_stop.get)
    except TimeoutError:
        return Check(ok=False, detail=f"no answer in {STORE_TIMEOUT_S:g} s")
    except RobomendError as error:
        return Check(ok=False, detail=str(error))
    return Check(ok=True, detail="")
