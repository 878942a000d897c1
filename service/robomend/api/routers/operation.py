"""/healthz, /readyz, /metrics, /version-info: for whoever runs the service.

Whether this instance can serve requests, and what is wrong where it cannot; told at once, always.

store      it reads and writes; failing or hanging is not ready
queue      how long the oldest write waits
loop       how late the event loop comes to new tasks
workers    there are some to be had
boards     shown; one robot's fault makes nobody unready
"""

from __future__ import annotations

import asyncio
from typing import Any

from fastapi import APIRouter, Response
from pydantic import Field

from robomend.api.deps import Parts, PartsDep, PrincipalDep
from robomend.api.gate import GuardedRoute
from robomend.api.problems import RETRY_AFTER_S, Problem, problems
from robomend.api.schemas.base import Out
from robomend.api.store_probe import ANSWER_S, Check, LoopWatch
from robomend.metrics import CONTENT_TYPE
from robomend.security import API, RULES
from robomend.version import version_info

# --- whether the service can serve


class Readiness(Out):
    """Whether this instance can serve requests."""

    ready: bool
    checks: dict[str, Check]


class Operation(Out):
    """Something that may be asked for."""

    method: str = Field(examples=["GET"])
    path: str = Field(description="a template", examples=["/api/v1/robots/{robot}"])


class Root(Out):
    """What this service is, and what whoever asks may do."""

    name: str = Field(examples=["robomend"])
    version: str
    operations: list[Operation]
    openapi: str = "/openapi.json"
    docs: str = "/docs"


QUEUE_AGE_S = 2.0
"""Of the oldest write, beyond which clients had better go elsewhere."""

DELAY_S = 1.0
"""Of the event loop."""

TURN_S = 0.005
"""For the event loop to come to it, and back."""


async def readiness(parts: Parts) -> Readiness:
    """Look at each part that requests need; for any event loop, and also while the service's own is held.

    Where that does not come in time to try the store and look at the boards, what is known already is told.
    """
    loop = parts.watch.loop
    if asyncio.get_running_loop() is loop:
        return _as_known(parts, await _asked(parts))
    asking = asyncio.run_coroutine_threadsafe(_asked(parts), loop)
    waiting = asyncio.wrap_future(asking)
    await asyncio.wait({waiting}, timeout=ANSWER_S + TURN_S)
    if waiting.done():
        return _as_known(parts, waiting.result())
    asking.cancel()
    return _as_known(parts, {})


async def _asked(parts: Parts) -> dict[str, Check]:
    """Have the store tried; return what only the service's own event loop can look at."""
    await parts.probe.check()
    return {"boards": _boards(parts)}


def _as_known(parts: Parts, more: dict[str, Check]) -> Readiness:
    """Return what any thread knows at once, and `more`, which makes nobody unready."""
    figures = parts.store.figures()
    checks = {
        "store": parts.probe.known,
        "queue": Check(
            ok=figures.oldest_write_s <= QUEUE_AGE_S,
            detail=f"{figures.queued_writes} writes wait, the oldest for {figures.oldest_write_s:.1f} s",
        ),
        "loop": _loop(parts.watch),
        "workers": Check(ok=parts.one_shots.alive, detail=""),
    }
    ready = all(check.ok for check in checks.values()) and not parts.hub.closing
    return Readiness(ready=ready, checks={**checks, **more})


def _loop(watch: LoopWatch) -> Check:
    delay_s = watch.delay_s
    return Check(ok=delay_s <= DELAY_S, detail=f"{delay_s * 1000:.0f} ms late")


def _boards(parts: Parts) -> Check:
    boards = parts.robots.boards.states()
    away = sorted(robot for robot, state in boards.items() if state != "connected")
    named = f": {', '.join(away[:10])}" if away else ""
    return Check(ok=not away, detail=f"{len(away)} of {len(boards)} not connected{named}")


router = APIRouter(tags=["operation"], route_class=GuardedRoute)


@router.get("/healthz", responses=problems())
async def healthz(parts: PartsDep) -> dict[str, str]:
    """Answer: the process is alive and its event loop turns. Restart it when it does not (503)."""
    if parts.watch.frozen:
        raise Problem(503, f"the event loop has not turned for {parts.watch.held_s:.0f} s", code="frozen")
    return {"status": "ok"}


@router.get("/readyz", responses={**problems(), 503: {"model": Readiness, "description": "Not ready"}})
async def readyz(parts: PartsDep, response: Response) -> Readiness:
    """Say whether requests can be served: the store reads and writes, no write waits for long, the event loop
    turns, workers live. Boards are told, but do not decide.
    """
    found = await readiness(parts)
    if not found.ready:
        response.status_code = 503
        response.headers["Retry-After"] = str(RETRY_AFTER_S[503])
    return found


@router.get(
    "/metrics", response_class=Response, responses={**problems(), 200: {"content": {CONTENT_TYPE: {}}}}
)
async def metrics(parts: PartsDep) -> Response:
    """Return the service's figures in Prometheus' text format."""
    return Response(await parts.metrics.text(), media_type=CONTENT_TYPE)


@router.get("/version-info", responses=problems())
async def get_version_info() -> dict[str, Any]:
    """Return the versions of robomend and of the parts that decide its answers."""
    return version_info()


# --- /api/v1: what there is, for programs that find their way.


@router.get(API, responses=problems())
async def get_root(principal: PrincipalDep) -> Root:
    """Return what this service can do for whoever asks, and where the rest is said."""
    operations = [
        Operation(method=method, path=path)
        for (method, path), roles in RULES.items()
        if path.startswith(API) and (roles is None or principal.role in roles)
    ]
    return Root(name="robomend", version=version_info()["robomend"] or "0", operations=operations)
