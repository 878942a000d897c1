"""/robots/{robot}/plans: plan, without acting."""

from __future__ import annotations

from fastapi import APIRouter
from starlette.responses import JSONResponse

from robomend.api.deps import PartsDep, RobotPath
from robomend.api.documented import problems
from robomend.api.gate import GuardedRoute
from robomend.api.schemas.plans import ChoiceOut
from robomend.api.schemas.repair import PlanBody
from robomend.security import API

router = APIRouter(prefix=f"{API}/robots/{{robot}}/plans", tags=["repair"], route_class=GuardedRoute)


@router.post("", response_model=ChoiceOut, responses=problems(404, 409, body=True))
async def plan_repair(robot: RobotPath, body: PlanBody, parts: PartsDep) -> JSONResponse:
    """Plan a repair of the diagnosis `bad`, or of the best choice among those there are; nothing is done."""
    found = await parts.repairs.plan(
        robot, bad=body.bad, planner=body.planner, timeout_s=body.timeout_s, pddl=body.pddl
    )
    return JSONResponse(dict(found))
