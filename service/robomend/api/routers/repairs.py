"""/repairs: what was found, planned and done, and a person's yes or no to it.

Repairs are JSON already when they come from the loop: RepairOut only describes them.
"""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query
from starlette.responses import JSONResponse, Response

from robomend.api.deps import PartsDep, PrincipalDep, RepairPath, RobotPath, SpanDep
from robomend.api.documented import problems
from robomend.api.gate import GuardedRoute
from robomend.api.schemas.base import Items
from robomend.api.schemas.repair import DecisionBody, RepairBody
from robomend.api.schemas.repair_record import RepairOut
from robomend.api.views import page_text, response_of
from robomend.repairs.repair_json import repair_json
from robomend.repairs.states import RepairState
from robomend.security import API
from robomend.store import View, repairs
from robomend.timestamps import with_texts

router = APIRouter(prefix=API, tags=["repair"], route_class=GuardedRoute)


@router.post(
    "/robots/{robot}/repairs",
    status_code=202,
    response_model=RepairOut,
    responses=problems(404, 409, body=True),
)
async def create_repair(
    robot: RobotPath, body: RepairBody, parts: PartsDep, principal: PrincipalDep
) -> JSONResponse:
    """Ask for a repair of the diagnosis `bad`, or of the best choice; a conflict while one is open."""
    repair = await parts.repairs.create(robot, bad=body.bad, by=principal.name, reason=body.reason)
    return JSONResponse(with_texts(repair), 202, {"Location": f"{API}/repairs/{repair['id']}"})


@router.get("/robots/{robot}/repairs", response_model=Items[RepairOut], responses=problems(404))
async def list_repairs(
    robot: RobotPath, parts: PartsDep, paging: SpanDep, state: RepairState | None = None
) -> JSONResponse:
    """List the robot's repairs, newest first; of one state, or begun in a span of time."""
    found = await parts.repairs.repairs(
        robot,
        before=paging.cursor,
        limit=paging.limit,
        state=state,
        since_ns=paging.since_ns,
        until_ns=paging.until_ns,
    )
    more = len(found) == paging.limit
    items = [with_texts(repair) for repair in found]
    return JSONResponse({"items": items, "next": items[-1]["id"] if more else None})


@router.get("/repairs", response_model=Items[RepairOut], responses=problems(404))
async def list_all_repairs(
    parts: PartsDep,
    paging: SpanDep,
    state: RepairState | None = None,
    open_only: Annotated[bool, Query(alias="open", description="only those that have not ended")] = False,
) -> Response:
    """List the repairs of all robots, newest first; of one state, or begun in a span of time."""

    def look(view: View) -> bytes:
        found = repairs.page(view, None, paging, open_only=open_only, state=state)
        items = (with_texts(repair_json(one, repairs.steps(view, one.id))) for one in found.items)
        return page_text(items, found.next)

    return response_of(await parts.store.read(look))


@router.get("/repairs/{repair}", response_model=RepairOut, responses=problems(404))
async def get_repair(repair: RepairPath, parts: PartsDep) -> JSONResponse:
    """Return a repair with its diagnosis, plan and steps."""
    return JSONResponse(with_texts(await parts.repairs.repair(repair)))


@router.post("/repairs/{repair}", response_model=RepairOut, responses=problems(404, 409, body=True))
async def decide(
    repair: RepairPath, body: DecisionBody, parts: PartsDep, principal: PrincipalDep
) -> JSONResponse:
    """Approve a repair that awaits it, or cancel one that has not ended."""
    ask = parts.repairs.approve if body.decision == "approve" else parts.repairs.cancel
    return JSONResponse(with_texts(await ask(repair, by=principal.name, reason=body.reason)))
