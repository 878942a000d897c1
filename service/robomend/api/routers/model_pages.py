"""/ui/models and /ui/what-if: models as people read and mend them, and questions that touch no robot."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from robomend.api.deps import ModelPath, PagingDep, Parts, PartsDep, PrincipalDep
from robomend.api.page_route import PageRoute, back, page, read_form, reason_of, shell, wanted_parts
from robomend.api.problems import of_error
from robomend.api.schemas.base import NAME
from robomend.diagnosis.result import Options
from robomend.errors import InputError, RobomendError
from robomend.model.answers import answered
from robomend.oneshots.plan_json import choice_json
from robomend.oneshots.result_json import result_json
from robomend.store import models
from robomend.store.records import ABSENT, Paging
from robomend.web.suspicion import suspicions, whys, with_priors

router = APIRouter(route_class=PageRoute, include_in_schema=False)

PLAN_S = 10.0
MODEL_BYTES = 4 << 20
"""Of a form: larger models are put by a program."""
SHOWN = 20
"""Diagnoses of a question."""

EMPTY = """robomend: 1
hardware:
  battery: {channel: 1}
nodes:
  driver: {drives: [battery], publishes: {status: []}}
"""


@router.get("/ui/models")
async def models_page(
    request: Request, parts: PartsDep, principal: PrincipalDep, paging: PagingDep
) -> Response:
    """List the models, and offer to write another."""
    found = await parts.store.read(models.page, paging)
    values: dict[str, Any] = {"models": found, "name": "", "source": EMPTY, "expected": "", "problem": None}
    return await page(request, "models.html", **_around(request, parts, principal), **values)


@router.get("/ui/models/{name}")
async def model_page(
    request: Request, name: ModelPath, parts: PartsDep, principal: PrincipalDep, version: int | None = None
) -> Response:
    """Show a model as it was written, with what its loader says of it, and its versions."""
    model, system = await parts.robots.models.current(name)
    versions = await parts.store.read(models.versions, name, Paging(limit=50))
    shown = next((one for one in versions.items if one.number == version), model)
    values: dict[str, Any] = {"model": shown, "system": system, "versions": versions.items, "newest": model}
    return await page(
        request,
        "model.html",
        **_around(request, parts, principal),
        **values,
        name=name,
        source=shown.source,
        expected=model.version,
        problem=None,
    )


@router.post("/ui/models")
async def put_model(request: Request, parts: PartsDep, principal: PrincipalDep) -> Response:
    """Create a model or add a version; one that is refused comes back as it was written, with the place."""
    form = await read_form(request, min(MODEL_BYTES, 3 * parts.settings.max_model_bytes))
    name, source, expected = form.get("name", ""), form.get("source", ""), form.get("expected", "")
    try:
        if not _named(name):
            raise InputError("a model's name is 1 to 64 letters, digits, '.', '_' or '-'")
        await parts.robots.models.put(
            name,
            source,
            format=None,
            expected=expected or ABSENT,
            by=principal.name,
            reason=reason_of(form),
        )
    except RobomendError as error:
        problem = of_error(error)
        values = {"name": name, "source": source, "expected": expected, "problem": problem}
        around = _around(request, parts, principal)
        values["excerpt"] = _excerpt(source, problem.extra.get("line"))
        return await page(request, "model_refused.html", problem.status, **around, **values)
    return back(f"/ui/models/{name}")


@router.post("/ui/models/{name}/answers")
async def answer(request: Request, name: ModelPath, parts: PartsDep, principal: PrincipalDep) -> Response:
    """Put an answer to a question that a first model asks into its text, as a new version."""
    form = await read_form(request)
    model, _ = await parts.robots.models.current(name)
    question, said = form.get("question", ""), form.get("answer", "")
    await parts.robots.models.put(
        name,
        answered(model.source, question, said),
        format=None,
        expected=model.version,
        by=principal.name,
        reason=reason_of(form) or f"{question}: {said or 'nothing'}",
    )
    robot = form.get("robot", "")
    return back(f"/ui/robots/{robot}" if _named(robot) else f"/ui/models/{name}")


@router.get("/ui/what-if")
async def what_if(
    request: Request,
    parts: PartsDep,
    principal: PrincipalDep,
    model: Annotated[str, Query(max_length=64)] = "",
    observations: Annotated[str, Query(max_length=20_000)] = "",
    healthy: Annotated[str, Query(max_length=4000)] = "",
    abnormal: Annotated[str, Query(max_length=4000)] = "",
) -> Response:
    """Show what would be diagnosed and planned, if this was seen; no robot is touched."""
    there = await parts.store.read(models.page, Paging(limit=1000))
    asked = {"observations": observations, "healthy": healthy, "abnormal": abnormal}
    values: dict[str, Any] = {"models": [one.name for one in there.items], "model": model, "asked": asked}
    answer: dict[str, Any] = {"problem": None, "result": None, "choice": None, "no_plan": ""}
    if model:
        try:
            answer |= await _answer(parts, model, {name: _lines(text) for name, text in asked.items()})
        except RobomendError as error:
            answer["problem"] = of_error(error)
    around = _around(request, parts, principal)
    return await page(request, "what_if.html", **around, **values, **answer, most=SHOWN)


async def _answer(parts: Parts, model: str, asked: Mapping[str, list[str]]) -> dict[str, Any]:
    """Return what would be diagnosed and planned."""
    subject = await parts.robots.models.subject(model, None)
    question = await parts.robots.models.question(subject, asked["observations"])
    options = Options(
        timeout_s=parts.settings.solver_timeout_s,
        healthy=frozenset(asked["healthy"]),
        abnormal=frozenset(asked["abnormal"]),
    )
    result = result_json(await parts.one_shots.diagnose(subject, question, "sat", options))
    found = suspicions(subject.system.cnf.components, result)
    answer = {"result": result, "whys": whys(found, result), "priors": with_priors(result)}
    if subject.system.parts is None or not answer["whys"]:
        return answer
    bad = result["diagnoses"][0]["bad"] if asked["healthy"] or asked["abnormal"] else None
    try:
        choice = await parts.one_shots.plan(
            subject,
            question,
            bad=bad,
            expected_stopped=(),
            planner="pyperplan",
            timeout_s=PLAN_S,
            pddl=False,
        )
    except RobomendError as error:
        return {**answer, "no_plan": str(error)}
    return {**answer, "choice": choice_json(choice, subject.system.cnf.components)}


def _around(request: Request, parts: Parts, principal: Any) -> dict[str, Any]:
    return shell(request, parts, principal, wanted_parts(request, ("stop",)))


def _lines(text: str) -> list[str]:
    """Return what stands in each line."""
    return [line.strip() for line in text.splitlines() if line.strip()]


def _named(name: str) -> bool:
    return re.match(NAME, name) is not None


def _excerpt(source: str, line: object) -> list[tuple[int, str]]:
    """Return the line at fault with those around it, numbered."""
    if not isinstance(line, int):
        return []
    lines = source.split("\n")
    first = max(1, line - 2)
    return [(number, lines[number - 1]) for number in range(first, min(line + 2, len(lines)) + 1)]
