"""/ui/models/{name}/isolability and …/compare: what a model can tell apart, and how two versions differ."""

from __future__ import annotations

import json
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from markupsafe import Markup
from starlette.responses import Response

from robomend.api.deps import ModelPath, Parts, PartsDep, PrincipalDep
from robomend.api.page_route import PageRoute, page, shell, wanted_parts
from robomend.api.problems import of_error
from robomend.errors import NotFound, RobomendError
from robomend.model.system import System
from robomend.robots.declared import observables_at_hand
from robomend.store import models
from robomend.store.records import Paging, StoredModel
from robomend.web.comparison import compare, isolability_change
from robomend.web.isolability_matrix import isolability_matrix

router = APIRouter(route_class=PageRoute, include_in_schema=False)

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


def _around(request: Request, parts: Parts, principal: Any) -> dict[str, Any]:
    return shell(request, parts, principal, wanted_parts(request, ("stop",)))
