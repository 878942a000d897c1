"""/healthz, /readyz, /metrics, /version-info: for whoever runs the service."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Response

from robomend.api.deps import PartsDep
from robomend.api.documented import problems
from robomend.api.gate import GuardedRoute
from robomend.api.problems import RETRY_AFTER_S, Problem
from robomend.api.readiness import readiness
from robomend.api.schemas.operation import Readiness
from robomend.metrics import CONTENT_TYPE
from robomend.version import version_info

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
