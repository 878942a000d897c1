"""/drills: faults that are planted on purpose, watched, and undone."""

from __future__ import annotations

from fastapi import APIRouter, Response

from robomend.api.deps import DrillPath, PagingDep, PartsDep, PrincipalDep, RobotPath
from robomend.api.gate import GuardedRoute
from robomend.api.problems import problems
from robomend.api.schemas.base import Items
from robomend.api.schemas.drill import DrillBody, DrillDecisionBody, DrillOut
from robomend.security import API

router = APIRouter(prefix=API, tags=["drill"], route_class=GuardedRoute)


@router.post("/robots/{robot}/drills", status_code=202, responses=problems(404, 409, body=True))
async def create_drill(
    robot: RobotPath, body: DrillBody, parts: PartsDep, principal: PrincipalDep, response: Response
) -> DrillOut:
    """Plant a fault, watch what becomes of it, and undo it.

    Refused (403) for what is protected or has no undo; a conflict on a robot that is in use or not healthy.
    """
    drill = await parts.drills.create(
        robot,
        fault=body.fault,
        component=body.component,
        topic=body.topic,
        bound_s=body.bound_s,
        detect_s=body.detect_s,
        by=principal.name,
        reason=body.reason,
    )
    response.headers["Location"] = f"{API}/drills/{drill['id']}"
    return DrillOut.model_validate(drill)


@router.get("/robots/{robot}/drills", responses=problems(404))
async def list_drills(robot: RobotPath, parts: PartsDep, paging: PagingDep) -> Items[DrillOut]:
    """List the robot's drills, newest first."""
    found = await parts.drills.drills(robot, before=paging.cursor, limit=paging.limit)
    more = len(found) == paging.limit
    items = [DrillOut.model_validate(drill) for drill in found]
    return Items(items=items, next=items[-1].id if more else None)


@router.get("/drills/{drill}", responses=problems(404))
async def get_drill(drill: DrillPath, parts: PartsDep) -> DrillOut:
    """Return a drill: what is planted, how it is undone, and what was seen."""
    return DrillOut.model_validate(await parts.drills.drill(drill))


@router.post("/drills/{drill}", responses=problems(404, 409, body=True))
async def decide_drill(
    drill: DrillPath, body: DrillDecisionBody, parts: PartsDep, principal: PrincipalDep
) -> DrillOut:
    """Cancel a drill, which undoes it; say that a person did what it waits for; or leave it to them."""
    said = await parts.drills.decide(drill, body.decision, by=principal.name, reason=body.reason)
    return DrillOut.model_validate(said)
