"""/history and /audit: what was, and who did what and why."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Query
from starlette.responses import Response

from robomend.api.deps import PartsDep, RobotPath, SpanDep
from robomend.api.documented import problems
from robomend.api.gate import GuardedRoute
from robomend.api.schemas.audit import AuditOut
from robomend.api.schemas.base import NAME, Items
from robomend.api.schemas.history import HistoryLine
from robomend.api.views import audit_json, history_text, page_text, response_of
from robomend.security import API
from robomend.store import View, audit

router = APIRouter(prefix=API, tags=["history"], route_class=GuardedRoute)


@router.get("/robots/{robot}/history", response_model=Items[HistoryLine], responses=problems(404))
async def get_history(
    robot: RobotPath,
    parts: PartsDep,
    paging: SpanDep,
    kind: Literal["observations", "diagnosis", "repair"] = "observations",
) -> Response:
    """Return accepted batches, diagnoses or repairs over time, newest first."""
    return response_of(await history_text(parts.store, robot, kind, paging))


@router.get("/audit", response_model=Items[AuditOut], responses=problems())
async def get_audit(
    parts: PartsDep,
    paging: SpanDep,
    robot: Annotated[str | None, Query(pattern=NAME)] = None,
    actor: Annotated[str | None, Query(max_length=200, description="who did it")] = None,
    action: Annotated[
        str | None, Query(max_length=100, description="what was done", examples=["robot.put"])
    ] = None,
) -> Response:
    """Return the audit log, newest first, of everything or of one robot, actor or action."""

    def look(view: View) -> bytes:
        page = audit.page(view, paging, robot=robot, actor=actor, action=action)
        return page_text(map(audit_json, page.items), page.next)

    return response_of(await parts.store.read(look))
