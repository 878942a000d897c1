"""/robots/{robot}/observations: what was observed comes in here, and OBS can be read.

The answer means that the batch is on disk. Its diagnosis follows as an event, or by a long poll of
…/diagnosis.
"""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Request, Response

from robomend.api.body import content_type
from robomend.api.deps import (
    IdempotencyKey,
    PartsDep,
    PrincipalDep,
    ReasonQuery,
    RobotPath,
    parts_of,
    principal_of,
)
from robomend.api.gate import GuardedRoute, reporter_of
from robomend.api.ingestion import OPENAPI_BODY, accepted_response, ingest, read_batch
from robomend.api.lists import NDJSON
from robomend.api.problems import problems
from robomend.api.schemas.observations import Accepted, Ingested, ObsOut
from robomend.api.views import obs_out
from robomend.security import API

router = APIRouter(prefix=f"{API}/robots/{{robot}}", tags=["observations"], route_class=GuardedRoute)

AssertionPath = Annotated[str, Path(min_length=1, max_length=200, description="the assertion's name")]


@router.post(
    "/observations",
    response_model=Accepted | Ingested,
    responses=problems(404, 409, body=True),
    openapi_extra=OPENAPI_BODY,
)
async def post_observations(
    request: Request, robot: RobotPath, idempotency_key: IdempotencyKey = None
) -> Response:
    """Take in observations: one JSON batch, or NDJSON with a batch in each line, which is read as it streams.

    NDJSON is kept in groups of lines: when a line is refused, the answer says how many lines before it were
    kept.
    """
    parts, principal = parts_of(request), principal_of(request)
    if content_type(request) == NDJSON:
        return await ingest(request, parts, robot, principal, idempotency_key)
    batch, once = await read_batch(request, parts, principal, idempotency_key)
    by = reporter_of(principal)
    with parts.shedding.one():
        outcome = await parts.robots.observe(robot, batch, by=by, once=once)
    return accepted_response(outcome)


@router.get("/observations", responses=problems(404))
async def get_observations(robot: RobotPath, parts: PartsDep) -> ObsOut:
    """Return OBS now: each literal with its source, its time, and whether it is still fresh."""
    return obs_out(await parts.robots.memory.latest(robot))


@router.delete("/assertions/{assertion}", responses=problems(404))
async def withdraw(
    robot: RobotPath,
    assertion: AssertionPath,
    parts: PartsDep,
    principal: PrincipalDep,
    reason: ReasonQuery = "",
) -> Accepted:
    """Withdraw a named assertion; what it said is no longer supposed."""
    by = reporter_of(principal)._replace(reason=reason)
    outcome = await parts.robots.withdraw(robot, assertion, by=by)
    return Accepted(revision=outcome.revision, changed=list(outcome.changed))
