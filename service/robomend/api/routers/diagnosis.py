"""/robots/{robot}/diagnosis and /probes: the explanation of OBS, and what to look at next."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from robomend.api.body import while_admitted
from robomend.api.deps import PartsDep, RobotPath
from robomend.api.gate import GuardedRoute
from robomend.api.problems import problems
from robomend.api.schemas.base import MAX_INT
from robomend.api.schemas.diagnosis import CurrentDiagnosis, ProbesOut
from robomend.api.views import diagnosis_response, probes_out
from robomend.security import API

router = APIRouter(prefix=f"{API}/robots/{{robot}}", tags=["diagnosis"], route_class=GuardedRoute)


@router.get("/diagnosis", response_model=CurrentDiagnosis, responses=problems(404))
async def get_diagnosis(
    request: Request,
    robot: RobotPath,
    parts: PartsDep,
    wait_s: Annotated[float, Query(ge=0, le=3600, description="wait this long for a newer revision")] = 0.0,
    after: Annotated[
        int | None, Query(ge=0, le=MAX_INT, description="newer than this; by default, than the current one")
    ] = None,
) -> Response:
    """Return the current diagnosis; `revision` says of which OBS. With `wait_s`, wait for a newer one first.

    Whichever instance is asked, it is of all that was acknowledged before; a large model whose diagnosis is
    still under way is answered with the one before.

    The wait is cut to the service's own limit; when nothing newer came, the answer is the current one.
    """
    state = await parts.robots.diagnosed(robot)
    if wait_s > 0:
        request.scope["robomend.waits"] = True
        async with while_admitted(request):
            await parts.robots.waiting.beyond(state, after, min(wait_s, parts.settings.max_wait_s))
    return diagnosis_response(state)


@router.get("/probes", responses=problems(404))
async def get_probes(
    robot: RobotPath, parts: PartsDep, limit: Annotated[int, Query(ge=1, le=100)] = 5
) -> ProbesOut:
    """Return the observations worth making next: expected information per cost, best first."""
    state = await parts.robots.memory.latest(robot)
    found = await parts.one_shots.probes(*state.question(), state.config.engine, limit)
    return probes_out(state.revision, found)
