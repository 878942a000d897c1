"""/status: how every robot is, as the page's first view shows it."""

from __future__ import annotations

import time
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request

from robomend.api.documented import problems
from robomend.api.gate import GuardedRoute
from robomend.api.schemas.status import StatusLineOut, StatusOut
from robomend.security import API
from robomend.web.fleet import Fleet

router = APIRouter(prefix=API, tags=["robots"], route_class=GuardedRoute)


@router.get("/status", responses=problems())
async def get_status(
    request: Request,
    q: Annotated[str, Query(max_length=200, description="words that are all in a line")] = "",
    state: Literal["", "healthy", "unhealthy", "degraded", "partly-unknown", "unknown", "waiting"] = "",
    page: Annotated[int, Query(ge=1, le=1_000_000)] = 1,
    rows: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> StatusOut:
    """Say how every robot is, what is wrong and what it waits for: whoever waits for a person comes first."""
    fleet: Fleet = request.app.state.fleet
    now_ns = time.time_ns()
    found = await fleet.page(search=q, state=state, number=page, rows=rows)
    return StatusOut(
        robots=[
            StatusLineOut(
                robot=line.id,
                model=line.model,
                policy=line.policy,
                state=None if line.state is None else line.state.value,
                headline="" if line.headline is None else line.headline.text(now_ns),
                finding=line.finding,
                more=line.more,
                waits=line.waits,
                waits_for_person=line.waits_for_person,
                since_ns=line.since_ns,
            )
            for line in found.lines
        ],
        found=found.found,
        total=found.total,
        counts=found.counts,
        page=found.number,
        pages=found.pages,
        complete=found.complete,
    )
