"""/models: system descriptions as versioned resources.

A robot follows its model: a new version recompiles and diagnoses anew without losing OBS. A bad model is
refused whole, and the old one stays.
"""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from robomend.api.deps import (
    IfMatch,
    IfNoneMatch,
    ModelPath,
    PagingDep,
    PartsDep,
    PrincipalDep,
    ReasonQuery,
    expected_etag,
    needs_etag,
    quoted,
)
from robomend.api.documented import problems
from robomend.api.gate import GuardedRoute
from robomend.api.model_text import OPENAPI_BODY, read_model
from robomend.api.schemas.base import Items
from robomend.api.schemas.models import ModelOut, VersionOut
from robomend.api.views import model_out, version_out
from robomend.security import API
from robomend.store import models
from robomend.store.records import ABSENT

router = APIRouter(prefix=f"{API}/models", tags=["models"], route_class=GuardedRoute)


@router.get("", responses=problems())
async def list_models(parts: PartsDep, paging: PagingDep) -> Items[VersionOut]:
    """List the models by name, each with its current version."""
    page = await parts.store.read(models.page, paging)
    return Items(items=[version_out(model) for model in page.items], next=page.next)


@router.get("/{name}", responses=problems(404))
async def get_model(name: ModelPath, parts: PartsDep, response: Response) -> ModelOut:
    """Return a model as it was written, with its components and what its loader warns of."""
    model, system = await parts.robots.models.current(name)
    response.headers["ETag"] = quoted(model.version)
    return model_out(model, system)


@router.put(
    "/{name}",
    responses={**problems(412, 428, body=True), 201: {"model": ModelOut, "description": "Created"}},
    openapi_extra=OPENAPI_BODY,
)
async def put_model(
    request: Request,
    name: ModelPath,
    parts: PartsDep,
    principal: PrincipalDep,
    response: Response,
    if_match: IfMatch = None,
    if_none_match: IfNoneMatch = None,
    reason: ReasonQuery = "",
) -> ModelOut:
    """Create a model, or add a version; replacing needs If-Match.
    The robots that follow it are diagnosed anew.
    """
    body = await read_model(request, parts.settings, parts.robots.readers)
    expected = expected_etag(if_match, if_none_match)
    model, system = await parts.robots.models.put(
        name, body.source, format=body.format, expected=expected, by=principal.name, reason=reason
    )
    response.status_code = 201 if model.number == 1 and expected in (None, ABSENT) else 200
    response.headers["ETag"] = quoted(model.version)
    return model_out(model, system)


@router.delete("/{name}", status_code=204, responses=problems(404, 409, 412, 428))
async def delete_model(
    name: ModelPath,
    parts: PartsDep,
    principal: PrincipalDep,
    if_match: IfMatch = None,
    reason: ReasonQuery = "",
) -> None:
    """Delete a model with all its versions; a conflict while a robot follows it."""
    await parts.robots.models.delete(name, expected=needs_etag(if_match), by=principal.name, reason=reason)


@router.get("/{name}/versions", responses=problems(404))
async def list_versions(name: ModelPath, parts: PartsDep, paging: PagingDep) -> Items[VersionOut]:
    """List all versions of a model, newest first."""
    page = await parts.store.read(models.versions, name, paging)
    return Items(items=[version_out(model) for model in page.items], next=page.next)
