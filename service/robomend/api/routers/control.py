"""/stop and /quarantine: a person's brakes on automatic repair."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path

from robomend.api.deps import PartsDep, PrincipalDep, RobotPath
from robomend.api.documented import problems
from robomend.api.gate import GuardedRoute
from robomend.api.schemas.repair import ReasonBody, StopOut
from robomend.security import API

router = APIRouter(prefix=API, tags=["control"], route_class=GuardedRoute)

ComponentPath = Annotated[str, Path(min_length=1, max_length=200)]


@router.get("/stop", responses=problems())
async def get_stop(parts: PartsDep) -> StopOut:
    """Return whether the global stop is active."""
    return StopOut.model_validate(await parts.repairs.stopped())


@router.post("/stop", responses=problems(body=True))
async def stop(body: ReasonBody, parts: PartsDep, principal: PrincipalDep) -> StopOut:
    """Stop: no action starts anywhere, running ones are cancelled; it stays over a restart."""
    return StopOut.model_validate(await parts.repairs.stop(by=principal.name, reason=body.reason))


@router.delete("/stop", responses=problems())
async def resume(parts: PartsDep, principal: PrincipalDep) -> StopOut:
    """Lift the stop."""
    return StopOut.model_validate(await parts.repairs.resume(by=principal.name, reason=""))


@router.get("/robots/{robot}/quarantine", responses=problems(404))
async def get_quarantine(robot: RobotPath, parts: PartsDep) -> dict[str, str]:
    """Return the components that are not tried again, each with the reason."""
    return dict(await parts.repairs.quarantined(robot))


@router.post(
    "/robots/{robot}/quarantine/{component}/release", status_code=204, responses=problems(404, body=True)
)
async def release(
    robot: RobotPath, component: ComponentPath, body: ReasonBody, parts: PartsDep, principal: PrincipalDep
) -> None:
    """Let a component in quarantine be tried again."""
    await parts.repairs.release(robot, component, by=principal.name, reason=body.reason)
