"""/repairs: what was found, planned and done, and a person's yes or no to it.

Repairs are JSON already when they come from the loop: RepairOut only describes them.
"""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Query
from starlette.responses import JSONResponse, Response

from robomend.api.deps import PartsDep, PrincipalDep, RepairPath, RobotPath, SpanDep
from robomend.api.gate import GuardedRoute
from robomend.api.problems import problems
from robomend.api.schemas.base import Items
from robomend.api.schemas.repair import ChoiceOut, DecisionBody, PlanBody, RepairBody
from robomend.api.schemas.repair_record import ChangeOut, FunctionsOut, RepairOut
from robomend.api.views import functions_out, page_text, response_of
from robomend.repairs.repair_json import change_json, repair_json
from robomend.repairs.states import RepairState
from robomend.security import API
from robomend.store import View, repairs, robots
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


# --- /robots/{robot}/functions and /changes: by which variants a robot works, and what was changed.
#
# Changes are JSON already when they come from the store: ChangeOut only describes them.

ChangePath = Annotated[str, Path(pattern=r"^c-[A-Za-z0-9]{1,62}$", examples=["c-7k2m9x4q"])]


@router.get("/robots/{robot}/functions", responses=problems(404))
async def get_functions(robot: RobotPath, parts: PartsDep) -> FunctionsOut:
    """Say by which variant each function works, which it should work by, and why."""
    return functions_out(await parts.robots.diagnosed(robot))


@router.get("/robots/{robot}/changes", response_model=Items[ChangeOut], responses=problems(404))
async def list_changes(robot: RobotPath, parts: PartsDep, paging: SpanDep) -> Response:
    """List the changes of a robot's configuration, newest first; or those begun in a span of time."""

    def look(view: View) -> bytes:
        robots.get(view, robot)
        found = repairs.page(view, robot, paging, changes=True)
        items = (with_texts(change_json(one, repairs.steps(view, one.id))) for one in found.items)
        return page_text(items, found.next)

    return response_of(await parts.store.read(look))


@router.get("/changes/{change}", response_model=ChangeOut, responses=problems(404))
async def get_change(change: ChangePath, parts: PartsDep) -> JSONResponse:
    """Return a change with its acts."""

    def look(view: View) -> dict[str, Any]:
        return change_json(repairs.get(view, change), repairs.steps(view, change))

    return JSONResponse(with_texts(await parts.store.read(look)))


@router.post("/changes/{change}", response_model=ChangeOut, responses=problems(404, 409, body=True))
async def decide_on_change(
    change: ChangePath, body: DecisionBody, parts: PartsDep, principal: PrincipalDep
) -> JSONResponse:
    """Approve a change that awaits it, or cancel one that has not ended."""
    ask = parts.repairs.approve if body.decision == "approve" else parts.repairs.cancel
    return JSONResponse(with_texts(await ask(change, by=principal.name, reason=body.reason)))


# --- /robots/{robot}/plans: plan, without acting.


@router.post("/robots/{robot}/plans", response_model=ChoiceOut, responses=problems(404, 409, body=True))
async def plan_repair(robot: RobotPath, body: PlanBody, parts: PartsDep) -> JSONResponse:
    """Plan a repair of the diagnosis `bad`, or of the best choice among those there are; nothing is done."""
    found = await parts.repairs.plan(
        robot, bad=body.bad, planner=body.planner, timeout_s=body.timeout_s, pddl=body.pddl
    )
    return JSONResponse(dict(found))
