"""/history and /audit: what was, and who did what and why."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Query

from robomend.api.deps import PartsDep, RobotPath, SpanDep
from robomend.api.documented import problems
from robomend.api.gate import GuardedRoute
from robomend.api.schemas.base import NAME, Items
from robomend.api.schemas.history import AuditOut, HistoryLine
from robomend.api.views import audit_out, history_page
from robomend.security import API
from robomend.store import audit

router = APIRouter(prefix=API, tags=["history"], route_class=GuardedRoute)


@router.get("/robots/{robot}/history", responses=problems(404))
async def get_history(
    robot: RobotPath,
    parts: PartsDep,
    paging: SpanDep,
    kind: Literal["observations", "diagnosis", "repair"] = "observations",
) -> Items[HistoryLine]:
    """Return accepted batches, diagnoses or repairs over time, newest first."""
    return await history_page(parts.store, robot, kind, paging)


@router.get("/audit", responses=problems())
async def get_audit(
    parts: PartsDep,
    paging: SpanDep,
    robot: Annotated[str | None, Query(pattern=NAME)] = None,
    actor: Annotated[str | None, Query(max_length=200, description="who did it")] = None,
    action: Annotated[
        str | None, Query(max_length=100, description="what was done", examples=["robot.put"])
    ] = None,
) -> Items[AuditOut]:
    """Return the audit log, newest first, of everything or of one robot, actor or action."""
    page = await parts.store.read(audit.page, paging, robot=robot, actor=actor, action=action)
    return Items(items=[audit_out(entry) for entry in page.items], next=page.next)
