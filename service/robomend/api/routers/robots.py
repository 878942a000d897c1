"""/robots: what is configured of each robot.

A robot's ETag has two parts, `"CONFIGURATION.ANSWER"`: If-None-Match compares both, as how the robot is
changes by itself; If-Match the first alone, as that is what a PUT replaces.
"""

from __future__ import annotations

import asyncio
import hashlib

from fastapi import APIRouter, Response

from robomend.api.deps import (
    IfMatch,
    IfNoneMatch,
    PagingDep,
    Parts,
    PartsDep,
    PrincipalDep,
    ReasonQuery,
    RobotPath,
    expected_etag,
    needs_etag,
    quoted,
)
from robomend.api.gate import GuardedRoute
from robomend.api.problems import problems
from robomend.api.schemas.base import Items
from robomend.api.schemas.models import FiveKeyOut
from robomend.api.schemas.robots import RobotBody, RobotLine, RobotOut
from robomend.api.views import five_key_out, robot_line, robot_out
from robomend.errors import TooLarge
from robomend.model.five_key import five_key_of
from robomend.robots.robot import Robot
from robomend.security import API
from robomend.store import robots
from robomend.store.records import ABSENT

MOST_CLAUSES = 20_000
"""Of a model that is told whole in five keys."""

router = APIRouter(prefix=f"{API}/robots", tags=["robots"], route_class=GuardedRoute)


@router.get("", responses=problems())
async def list_robots(parts: PartsDep, paging: PagingDep) -> Items[RobotLine]:
    """List the robots by id."""
    page = await parts.store.read(robots.page, paging)
    return Items(items=[robot_line(robot) for robot in page.items], next=page.next)


@router.get("/{robot}", responses=problems(404))
async def get_robot(robot: RobotPath, parts: PartsDep, response: Response) -> RobotOut:
    """Return a robot's configuration, its revision and whether it is healthy."""
    return await _answer(await parts.robots.diagnosed(robot), parts, response)


@router.get("/{robot}/model", responses=problems(404, 413))
async def get_model_of_robot(robot: RobotPath, parts: PartsDep) -> FiveKeyOut:
    """Return the model that a robot follows as propositions and clauses: the five keys of the published
    system.
    """
    state = await parts.robots.memory.robot(robot)
    if len(state.system.cnf.clauses) > MOST_CLAUSES:
        raise TooLarge(
            f"the model {state.model.name} has {len(state.system.cnf.clauses)} clauses, and {MOST_CLAUSES} "
            "are told in five keys; `robomend compile --format five-key` writes all of them"
        )
    keys = await asyncio.to_thread(five_key_of, state.system.cnf)
    return five_key_out(state.model, keys)


@router.put(
    "/{robot}",
    responses={**problems(404, 409, 412, 428, body=True), 201: {"model": RobotOut, "description": "Created"}},
)
async def put_robot(
    robot: RobotPath,
    body: RobotBody,
    parts: PartsDep,
    principal: PrincipalDep,
    response: Response,
    if_match: IfMatch = None,
    if_none_match: IfNoneMatch = None,
    reason: ReasonQuery = "",
) -> RobotOut:
    """Create a robot, or replace its configuration; replacing needs If-Match. OBS stays."""
    expected = expected_etag(if_match, if_none_match)
    if expected is not None:
        expected = _configuration(expected)
    config = body.model_dump(mode="json")
    parts.repairs.check_actions(robot, config["actions"])
    state = await parts.robots.put_robot(robot, config, expected=expected, by=principal.name, reason=reason)
    response.status_code = 201 if expected in (None, ABSENT) else 200
    return await _answer(state, parts, response)


@router.delete("/{robot}", status_code=204, responses=problems(404, 409, 412, 428))
async def delete_robot(
    robot: RobotPath,
    parts: PartsDep,
    principal: PrincipalDep,
    if_match: IfMatch = None,
    reason: ReasonQuery = "",
) -> None:
    """Delete a robot; a conflict while a repair or a drill is open.

    Its history stays as long as the retention says.
    """
    expected = _configuration(needs_etag(if_match))
    await parts.robots.delete_robot(robot, expected=expected, by=principal.name, reason=reason)


async def _answer(state: Robot, parts: Parts, response: Response) -> RobotOut:
    """Return a robot as it is now, and name the answer."""
    findings, drill = await parts.repairs.findings(state.id), await parts.drills.open_of(state.id)
    newest = await parts.repairs.repairs(state.id, before=None, limit=1)
    out = robot_out(state, findings, drill, newest[0] if newest else None)
    digest = hashlib.sha256(out.model_dump_json().encode()).hexdigest()[:20]
    response.headers["ETag"] = quoted(f"{out.etag}.{digest}")
    return out


def _configuration(expected: str) -> str:
    """Return the part of an ETag that If-Match is about."""
    return expected.partition(".")[0]
