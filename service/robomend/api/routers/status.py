"""/status: how every robot is, as the page's first view shows it."""

from __future__ import annotations

import time
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request
from pydantic import Field

from robomend.api.gate import GuardedRoute
from robomend.api.problems import problems
from robomend.api.schemas.base import Moment, Out, moment_of
from robomend.security import API
from robomend.web.fleet import Fleet

# --- all robots at a glance.


class StatusLineOut(Out):
    """How a robot is, what is wrong with it and what it waits for, in words."""

    robot: str
    model: str
    policy: str
    state: Literal["healthy", "unhealthy", "degraded", "partly-unknown", "unknown"] | None = Field(
        description="null: not read yet, ask again"
    )
    headline: str = Field(
        description="what is wrong since when, what follows, and what happens next or who is needed",
        examples=["hokuyo has no power since 23:23:04; scan and 4 more follow. Power up hokuyo?"],
    )
    finding: str = Field(description="the leading diagnosis, or why there is none", examples=["hokuyo"])
    more: int = Field(description="diagnoses besides the leading one")
    waits: str = Field(description="what it waits for; empty: nothing", examples=["approval of a plan"])
    waits_for_person: bool
    since_ns: int | None = Field(description="of the diagnosis")
    since: Moment | None = moment_of("since_ns")


class StatusOut(Out):
    """A page of the robots that a search and a filter leave, the most urgent first."""

    robots: list[StatusLineOut]
    found: int = Field(description="how many the search and the filter leave")
    total: int
    counts: dict[str, int] = Field(description="robots by state, and those `waiting` for a person")
    page: int
    pages: int
    complete: bool = Field(description="false: some robots were not read yet, ask again")


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
