"""/ui/models and /ui/what-if: models as people read and mend them, what they can tell apart, how versions
differ, and questions that touch no robot.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from markupsafe import Markup
from starlette.responses import Response

from robomend.api.deps import ModelPath, PagingDep, Parts, PartsDep, PrincipalDep
from robomend.api.page_route import PageRoute, back, page, read_form, reason_of, shell, wanted_parts
from robomend.api.problems import of_error
from robomend.api.schemas.base import NAME
from robomend.diagnosis.result import Options
from robomend.errors import InputError, NotFound, RobomendError
from robomend.model.answers import answered
from robomend.model.system import System
from robomend.oneshots.plan_json import choice_json
from robomend.oneshots.result_json import result_json
from robomend.robots.declared import observables_at_hand
from robomend.store import models
from robomend.store.records import ABSENT, Paging, StoredModel
from robomend.web.comparison import compare, isolability_change
from robomend.web.isolability_matrix import isolability_matrix
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


# --- …/isolability and …/compare: what a model can tell apart, and how two versions differ


LONGEST_S = 10.0
VERSIONS = 50
"""So many of the newest can be compared."""

Version = Annotated[int | None, Query(ge=1)]


@router.get("/ui/models/{name}/isolability")
async def isolability_page(
    request: Request,
    name: ModelPath,
    parts: PartsDep,
    principal: PrincipalDep,
    robot: Annotated[str, Query(max_length=64)] = "",
) -> Response:
    """Show which faults could be told apart, by all that can be observed or by what a robot reports."""
    model, system = await parts.robots.models.current(name)
    values: dict[str, Any] = {"name": name, "model": model, "robot": robot, "problem": None, "report": None}
    try:
        observed = None
        if robot:
            state = await parts.robots.memory.latest(robot)
            observed = observables_at_hand(state.config, system, state.sight.declared.agents())
        report = await _report(parts, system, observed)
        values["report"] = report
        values["figure"] = None if report["matrix"] is None else _figure(name, report)
    except RobomendError as error:
        values["problem"] = of_error(error)
    return await page(request, "isolability.html", **_around(request, parts, principal), **values)


@router.get("/ui/models/{name}/compare")
async def compare_page(
    request: Request,
    name: ModelPath,
    parts: PartsDep,
    principal: PrincipalDep,
    before: Version = None,
    after: Version = None,
) -> Response:
    """Show how two versions of a model differ; without being asked for others, the newest two."""
    versions = (await parts.store.read(models.versions, name, Paging(limit=VERSIONS))).items
    new = _version(name, versions, after or versions[0].number)
    old = _version(name, versions, before or max(1, new.number - 1))
    systems = [
        await parts.robots.models.readers.model(one.source, name=name, format=one.format)
        for one in (old, new)
    ]
    values: dict[str, Any] = {"name": name, "before": old, "after": new, "versions": versions}
    values |= {"difference": compare(*systems), "change": None, "problem": None}
    try:
        values["change"] = isolability_change(*[await _report(parts, system, None) for system in systems])
    except RobomendError as error:
        values["problem"] = of_error(error)
    return await page(request, "compare.html", **_around(request, parts, principal), **values)


async def _report(parts: Parts, system: System, observed: Any) -> dict[str, Any]:
    timeout_s = min(LONGEST_S, parts.settings.solver_timeout_s)
    text = await parts.one_shots.isolability(system, observed, double=False, timeout_s=timeout_s)
    found: dict[str, Any] = json.loads(text)
    return found


def _figure(name: str, report: dict[str, Any]) -> Markup:
    faults = report["faults"]
    svg = isolability_matrix(
        f"Isolability of {name}",
        [fault["components"] for fault in faults],
        report["matrix"],
        [fault["detectable"] for fault in faults],
    )
    return Markup(svg)  # our own drawing, which escapes what was named


def _version(name: str, versions: Any, number: int) -> StoredModel:
    found: StoredModel | None = next((one for one in versions if one.number == number), None)
    if found is None:
        raise NotFound(f"{name} has no version {number} among its newest {VERSIONS}")
    return found
