"""/diagnoses and /plans: stateless one-shots and what-if. Model and observations in, result out."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter

from robomend.api.deps import PartsDep
from robomend.api.documented import problems
from robomend.api.gate import GuardedRoute
from robomend.api.schemas.diagnosis import AskBody, ResultOut
from robomend.api.schemas.repair import OneShotPlanBody
from robomend.api.views import engine_options
from robomend.oneshots.oneshots import Question
from robomend.security import API

router = APIRouter(prefix=API, tags=["one-shots"], route_class=GuardedRoute)


@router.post("/diagnoses", responses=problems(404, body=True))
async def diagnose(body: AskBody, parts: PartsDep) -> ResultOut:
    """Diagnose observations over a model, with components assumed healthy or abnormal if asked: what if?"""
    question = Question(body.model, body.source, tuple(body.observations))
    options = engine_options(body.options, parts.settings, healthy=body.healthy, abnormal=body.abnormal)
    return ResultOut.model_validate(await parts.one_shots.diagnose(question, body.options.engine, options))


@router.post("/plans", responses=problems(404, body=True))
async def plan(body: OneShotPlanBody, parts: PartsDep) -> dict[str, Any]:
    """Choose and plan a repair over a model and observations, or plan for the components `bad`."""
    question = Question(body.model, body.source, tuple(body.observations))
    return await parts.one_shots.plan(
        question,
        bad=body.bad,
        expected_stopped=tuple(body.expected.stopped),
        planner=body.planner,
        timeout_s=body.timeout_s,
        pddl=body.pddl,
    )
