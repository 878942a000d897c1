"""/actions: the agent's side of repair. It pulls what to do, says how far it is, and how it ended."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response

from robomend.api.body import while_admitted
from robomend.api.deps import ActionPath, PartsDep, PrincipalDep, RobotPath
from robomend.api.gate import GuardedRoute, reporter_of
from robomend.api.problems import Problem, problems
from robomend.api.schemas.base import MAX_INT
from robomend.api.schemas.repair import (
    ActionOut,
    ActionResultBody,
    FeedbackBody,
    FirstResult,
    OrdersOut,
    PollBody,
)
from robomend.errors import NotFound
from robomend.repairs.repairs import Repairs
from robomend.security import API, Principal, Role


async def check_own_action(repairs: Repairs, principal: Principal, action: str) -> None:
    """Let a robot's key through to its own actions; the others do not exist for it."""
    if principal.role is Role.ROBOT and await repairs.action_robot(action) != principal.robot:
        raise NotFound(f"there is no action {action!r}")


router = APIRouter(prefix=API, tags=["agent"], route_class=GuardedRoute)


@router.get(
    "/robots/{robot}/actions/next",
    response_model=ActionOut,
    responses={**problems(404, 405), 204: {"description": "Nothing to do"}},
    deprecated=True,
)
async def next_action(
    request: Request,
    response: Response,
    robot: RobotPath,
    parts: PartsDep,
    principal: PrincipalDep,
    wait_s: Annotated[float, Query(ge=0, le=3600, description="wait this long for one")] = 0.0,
    host: Annotated[str | None, Query(max_length=253, description="which of the robot's agents asks")] = None,
) -> Any:
    """Agents of the version before: as POST, without saying what the agent can do. With a key in the header
    only: a browser sends GETs for any page that it shows.
    """
    if "authorization" not in request.headers:
        headers = {"Allow": "POST"}
        raise Problem(405, "actions are taken by POST, so that no page can take one", headers=headers)
    response.headers["Deprecation"] = "true"
    request.scope["robomend.waits"] = wait_s > 0
    async with parts.robots.waiting.counted(), while_admitted(request):
        orders = await parts.repairs.orders(
            robot, host=host, wait_s=min(wait_s, parts.settings.max_wait_s), by=reporter_of(principal)
        )
    return ActionOut.model_validate(orders) if orders else Response(status_code=204)


@router.post(
    "/robots/{robot}/actions/next",
    response_model=OrdersOut,
    response_model_exclude_unset=True,
    responses={**problems(404, 422, body=True), 204: {"description": "Nothing to do"}},
)
async def poll(
    request: Request,
    robot: RobotPath,
    body: PollBody,
    parts: PartsDep,
    principal: PrincipalDep,
    starved_ns: Annotated[
        int | None, Query(ge=0, le=MAX_INT, description="since when the agent's computer is starved")
    ] = None,
) -> Any:
    """Return the agent's next action, the same again until its first feedback or result came in, and what its
    observers are to judge anew, since an action may have changed it.
    """
    request.scope["robomend.waits"] = body.wait_s > 0
    async with parts.robots.waiting.counted(), while_admitted(request):
        orders = await parts.repairs.orders(
            robot,
            host=body.host,
            wait_s=min(body.wait_s, parts.settings.max_wait_s),
            agent=body.agent,
            can=body.can,
            observes={one.atom: (one.detection_s, one.settling_s) for one in body.observes},
            takes_s=body.takes_s,
            settled=body.settled,
            starved_ns=starved_ns,
            by=reporter_of(principal),
        )
    return OrdersOut.model_validate(orders) if orders else Response(status_code=204)


@router.post("/actions/{action}/feedback", status_code=204, responses=problems(404, 409, body=True))
async def post_feedback(
    action: ActionPath, body: FeedbackBody, parts: PartsDep, principal: PrincipalDep
) -> None:
    """Say how far an action is; after its result this is a conflict."""
    await check_own_action(parts.repairs, principal, action)
    await parts.repairs.feedback(action, code=body.code, message=body.message)


@router.post("/actions/{action}/result", responses=problems(404, body=True))
async def post_result(
    action: ActionPath, body: ActionResultBody, parts: PartsDep, principal: PrincipalDep
) -> FirstResult:
    """Report an action's end; a repeat is answered with the first report, which counts."""
    await check_own_action(parts.repairs, principal, action)
    by = reporter_of(principal)
    first = await parts.repairs.result(action, code=body.code, message=body.message, by=by)
    return FirstResult(code=first["code"], message=first["message"])
