"""/models: system descriptions as versioned resources, and what their faults can show.

A robot follows its model: a new version recompiles and diagnoses anew without losing OBS. A bad model is
refused whole, and the old one stays.

The body of PUT /models/{name}: JSON with the text in it, or the text itself, as `curl` sends files.
"""

from __future__ import annotations

from typing import Any, Literal

from fastapi import APIRouter, Request, Response
from pydantic import Field, ValidationError

from robomend.api.body import BYTES_PER_S, check_content_type, content_type, loads_in_turn, read_chunks
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
from robomend.api.gate import GuardedRoute
from robomend.api.problems import Problem, of_body, problems
from robomend.api.schemas.base import In, Items, Out, RobotId, Sentence
from robomend.api.schemas.models import ModelBody, ModelOut, VersionOut
from robomend.api.views import model_out, version_out
from robomend.errors import InputError
from robomend.robots.declared import observables_at_hand
from robomend.robots.readers import Readers
from robomend.security import API
from robomend.settings import Settings
from robomend.store import models
from robomend.store.records import ABSENT
from robomend_client.literals import Atom

# --- what faults can show: the question and its answer.


class IsolabilityBody(In):
    """What is at hand: named, or what a robot's observers report; neither: all that the rules speak of."""

    observed: list[Sentence] | None = Field(
        default=None, max_length=10_000, examples=[["ok(scan)", "on(hokuyo)"]], description="observables"
    )
    robot: RobotId | None = Field(
        default=None, description="a robot that follows the model: `observed` of it, its board, its agents"
    )
    double: bool = Field(default=False, description="compare double faults, too: bounded")
    timeout_s: float | None = Field(
        default=None, gt=0, le=3600, description="null: the service's own, for a diagnosis"
    )


class SingleOrDoubleFault(Out):
    """Components that are abnormal together."""

    components: list[str]
    detectable: bool | None = Field(description="null: not known, for want of time")


class LeftTogether(Out):
    """What no observable of the model tells apart; an empty rival is a healthy robot."""

    fault: list[str]
    rival: list[str]


class FurtherOut(Out):
    """The cheapest further observables that split a group, as far as any can."""

    atoms: list[str]
    cost_s: float
    left: list[LeftTogether]
    all_looked_at: bool = Field(description="false: there are many, and the first ones were looked at")


class SuggestionOut(Out):
    """What could be added to the model, and what to watch then."""

    add: str = Field(examples=["not ab(camera) -> ok(current,camera)"])
    watch: str


class FaultGroup(Out):
    """Faults that cannot be told from one another, nor from the rivals."""

    faults: list[list[str]]
    rivals: list[list[str]]
    further: FurtherOut | None = Field(description="null: there was no time to look, or too many were asked")
    suggestions: list[SuggestionOut]
    text: str


class DoubleFaultsOut(Out):
    """Double faults that were compared with one another and with single ones."""

    faults: list[SingleOrDoubleFault]
    groups: list[FaultGroup]
    complete: bool = Field(description="false: there are more")


class IsolabilityOut(Out):
    """Which faults can be detected and told apart."""

    observed: list[str]
    unused: list[str] = Field(description="observables that no rule speaks of")
    faults: list[SingleOrDoubleFault]
    matrix: list[str] | None = Field(
        examples=[["=+", "-="]],
        description="a line a fault, a place for each: = itself, - never told from it, ~ by some "
        "symptoms only, + always, ? not known; null for more than 500 faults",
    )
    groups: list[FaultGroup]
    undetectable: list[FaultGroup] = Field(description="one fault each")
    double: DoubleFaultsOut | None
    exact_by: Literal["signatures", "search"]
    complete: bool = Field(description="false: time ran out")
    elapsed_s: float
    text: list[str]


TEXTS = ("application/yaml", "text/yaml", "application/x-yaml", "text/x-yaml", "text/plain")

OPENAPI_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "application/json": {"schema": ModelBody.model_json_schema()},
            **{
                kind: {
                    "schema": {"type": "string", "minLength": 1, "description": "the model as it is written"},
                    "example": "robomend: 1\nname: lamp\nhardware:\n  battery: {channel: 1}\nnodes: {}\n",
                }
                for kind in TEXTS
            },
        },
    }
}


async def read_model(request: Request, settings: Settings, readers: Readers) -> ModelBody:
    """Return the model of a body. In JSON its line ends take two bytes, so that may be twice as long."""
    text = content_type(request) in TEXTS
    limit = max(settings.max_body_bytes, settings.max_model_bytes * (1 if text else 2))
    chunks = [chunk async for chunk in read_chunks(request, limit, settings.body_timeout_s, BYTES_PER_S)]
    body = b"".join(chunks)
    check_content_type(request, "application/json", *TEXTS)
    if text:
        value: Any = {"source": _decoded(body)}
    else:
        value = await loads_in_turn(body, settings.max_nesting, readers)
    try:
        return ModelBody.model_validate(value)
    except ValidationError as error:
        raise of_body(error, ModelBody) from error


def _decoded(body: bytes) -> str:
    try:
        return body.decode()
    except UnicodeDecodeError as error:
        raise Problem(400, f"the text is not UTF-8: byte {error.start}") from error


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


@router.post("/{name}/isolability", response_model=IsolabilityOut, responses=problems(404, body=True))
async def isolability(name: ModelPath, body: IsolabilityBody, parts: PartsDep) -> Response:
    """Say which faults can be detected and told apart by the observables at hand, and what would split the
    rest: before one happens.
    """
    subject = await parts.robots.models.subject(name, None)
    observed: set[Atom] | None = None
    if body.observed is not None:
        asked = await parts.robots.models.question(subject, body.observed)
        if asked.assertions:
            raise InputError("`observed` names observables, such as ok(scan), and nothing richer")
        observed = {literal.atom for literal in asked.literals}
    if body.robot is not None:
        state = await parts.robots.memory.latest(body.robot)
        if state.config.model != name:
            raise InputError(f"the robot {body.robot} follows the model {state.config.model}, not {name}")
        reported = observables_at_hand(state.config, subject.system, state.sight.declared.agents())
        observed = (observed or set()).union(reported)
    timeout_s = min(body.timeout_s or parts.settings.solver_timeout_s, parts.settings.max_solver_timeout_s)
    text = await parts.one_shots.isolability(
        subject.system, observed, double=body.double, timeout_s=timeout_s
    )
    return Response(text, media_type="application/json")
