"""/diagnoses and /plans: stateless one-shots and what-if. Model and observations in, result out."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Response

from robomend.api.deps import PartsDep
from robomend.api.gate import GuardedRoute
from robomend.api.problems import problems
from robomend.api.schemas.diagnosis import AskBody, ResultOut
from robomend.api.schemas.repair import ChoiceOut, OneShotPlanBody
from robomend.api.views import engine_options, response_of, result_response, value_response
from robomend.oneshots.plan_json import choice_json
from robomend.planning.choice import Choice
from robomend.security import API

router = APIRouter(prefix=API, tags=["one-shots"], route_class=GuardedRoute)


@router.post("/diagnoses", response_model=ResultOut, responses=problems(404, body=True))
async def diagnose(body: AskBody, parts: PartsDep) -> Response:
    """Diagnose observations over a model, with components assumed healthy or abnormal if asked: what if?"""
    options = engine_options(body.options, parts.settings, healthy=body.healthy, abnormal=body.abnormal)
    readers = parts.robots.readers
    if body.model is None and body.source is not None and not readers.at_once(body.source):
        packed = await readers.question(body.source, body.observations, options)
        return response_of(await parts.one_shots.answer(packed, body.options.engine))
    subject = await parts.robots.models.subject(body.model, body.source)
    asked = await parts.robots.models.question(subject, body.observations)
    return await result_response(await parts.one_shots.diagnose(subject, asked, body.options.engine, options))


@router.post("/plans", response_model=ChoiceOut, responses=problems(404, body=True))
async def plan(body: OneShotPlanBody, parts: PartsDep) -> Response:
    """Choose and plan a repair over a model and observations, or plan for the components `bad`."""
    subject = await parts.robots.models.subject(body.model, body.source)
    asked = await parts.robots.models.question(subject, body.observations)
    choice = await parts.one_shots.plan(
        subject,
        asked,
        bad=body.bad,
        expected_stopped=tuple(body.expected.stopped),
        planner=body.planner,
        timeout_s=body.timeout_s,
        pddl=body.pddl,
    )
    components = subject.system.cnf.components
    given = [choice, components, subject, asked]
    del choice, subject, asked  # a large model goes with its answer
    return await value_response(_choice_json, given)


def _choice_json(choice: Choice, components: tuple[str, ...], *_: object) -> dict[str, Any]:
    return choice_json(choice, components)
