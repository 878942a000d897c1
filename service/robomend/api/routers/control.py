"""/stop and /quarantine: a person's brakes on automatic repair."""

from __future__ import annotations

import time
from typing import Annotated, Any

from fastapi import APIRouter, Path, Request, Response

from robomend.api.deps import Parts, PartsDep, PrincipalDep, ReasonQuery, RobotPath
from robomend.api.gate import GuardedRoute
from robomend.api.problems import problems
from robomend.api.schemas.repair import ReasonBody, StopOut
from robomend.repairs.stop_switch import written
from robomend.security import API

router = APIRouter(prefix=API, tags=["control"], route_class=GuardedRoute)

ANSWER_S = 0.02
"""From the beginning of a request about the stop; then its answer does not wait for the disk any more."""

LEAST_S = 0.005
"""For the disk, where the way to here took longer: the processor is elsewhere."""

ComponentPath = Annotated[str, Path(min_length=1, max_length=200)]


UNWRITTEN: dict[int | str, dict[str, Any]] = {
    202: {"model": StopOut, "description": "Taken, and not on disk yet: `detail` tells what that means"}
}


@router.get("/stop", responses=problems())
async def get_stop(parts: PartsDep, request: Request) -> StopOut:
    """Return whether the global stop is active."""
    switch = parts.repairs.switch
    await switch.latest(_left_s(request))
    return StopOut.model_validate(switch.json(written=switch.settled))


@router.post("/stop", responses={**problems(body=True), **UNWRITTEN})
async def stop(
    body: ReasonBody, parts: PartsDep, principal: PrincipalDep, request: Request, response: Response
) -> StopOut:
    """Stop: no action starts anywhere, running ones are cancelled; it stays over a restart.

    Answers at once: where the stop is not on disk within a moment (202), it is in force on this instance, and
    on the others as soon as it is written.
    """
    on_disk = written(parts.repairs.switch.ask(True, by=principal.name, reason=body.reason), _left_s(request))
    return _answer(parts, response, await on_disk)


@router.delete("/stop", responses={**problems(507), **UNWRITTEN})
async def resume(
    parts: PartsDep, principal: PrincipalDep, request: Request, response: Response, reason: ReasonQuery = ""
) -> StopOut:
    """Lift the stop. It is lifted when that is on disk, which a 202 says it is not yet."""
    on_disk = written(parts.repairs.switch.ask(False, by=principal.name, reason=reason), _left_s(request))
    return _answer(parts, response, await on_disk)


def _left_s(request: Request) -> float:
    """Return how long the answer may wait for the disk."""
    taken_s: float = time.perf_counter() - request.scope["robomend.began"]
    return max(LEAST_S, ANSWER_S - taken_s)


def _answer(parts: Parts, response: Response, on_disk: bool) -> StopOut:
    if not on_disk:
        response.status_code = 202
    return StopOut.model_validate(parts.repairs.switch.json(written=on_disk))


@router.get("/robots/{robot}/quarantine", responses=problems(404))
async def get_quarantine(robot: RobotPath, parts: PartsDep) -> dict[str, str]:
    """Return the components that are not tried again, each with the reason."""
    return {name: entry.reason for name, entry in (await parts.repairs.quarantined(robot)).items()}


@router.post(
    "/robots/{robot}/quarantine/{component}/release", status_code=204, responses=problems(404, body=True)
)
async def release(
    robot: RobotPath, component: ComponentPath, body: ReasonBody, parts: PartsDep, principal: PrincipalDep
) -> None:
    """Let a component in quarantine be tried again."""
    await parts.repairs.release(robot, component, by=principal.name, reason=body.reason)
