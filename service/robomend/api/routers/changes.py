"""/robots/{robot}/functions and /changes: by which variants a robot works, and what was changed.

Changes are JSON already when they come from the store: ChangeOut only describes them.
"""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path
from starlette.responses import JSONResponse, Response

from robomend.api.deps import PartsDep, PrincipalDep, RobotPath, SpanDep
from robomend.api.documented import problems
from robomend.api.gate import GuardedRoute
from robomend.api.schemas.base import Items
from robomend.api.schemas.repair import DecisionBody
from robomend.api.schemas.repair_record import ChangeOut, FunctionsOut
from robomend.api.views import functions_out, page_text, response_of
from robomend.repairs.repair_json import change_json
from robomend.security import API
from robomend.store import View, repairs, robots
from robomend.timestamps import with_texts

router = APIRouter(prefix=API, tags=["repair"], route_class=GuardedRoute)

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
