"""`create_app`: the parts go in, an ASGI application comes out. No module-level app: two live in one process.

    edge (ids, Origin, log) ──► gate (key or Host, role, rate) ──► router ──► robots, repairs, store

The parts are started and closed by whoever made them (see robomend.api.runtime), not by the application.
"""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any

from fastapi import FastAPI
from fastapi.routing import APIRoute

from robomend.api import lists, problems
from robomend.api.deps import Parts
from robomend.api.edge import Edge
from robomend.api.gate import PLAIN, SECURE, Admission, Admitter
from robomend.api.ingestion import COMPONENTS, Express
from robomend.api.page_route import PagePace
from robomend.api.problems import MEDIA_TYPE, PROBLEM
from robomend.api.routers import (
    actions,
    batches,
    board,
    control,
    diagnosis,
    docs,
    drills,
    events,
    history,
    model_pages,
    models,
    moments,
    notifications,
    observations,
    oneshots,
    operation,
    pages,
    record_pages,
    repairs,
    robot_pages,
    robots,
    session,
    sovd,
    status,
)
from robomend.api.schemas.base import ProblemBody
from robomend.security import API, EVERYONE, RULES
from robomend.version import version_info
from robomend.web.fleet import Fleet

# --- what FastAPI does not write into the OpenAPI document by itself

DESCRIPTION = """Finds out why a robot misbehaves, repairs it, and looks whether it worked.

Observations come in, minimal diagnoses come out; repairs are planned, approved and carried out. Lists are
`{"items": [...], "next": ...}`, or NDJSON for those who ask; errors are problem details (RFC 9457) with a
stable `code`; what was acknowledged is on disk."""

TAGS = [
    {"name": "models", "description": "System descriptions, versioned; a robot follows its model"},
    {"name": "robots", "description": "What is configured of each robot"},
    {"name": "observations", "description": "What was observed comes in; OBS can be read"},
    {"name": "diagnosis", "description": "Why it misbehaves, and what to look at next"},
    {"name": "repair", "description": "Plans and repairs, and a person's yes or no"},
    {"name": "sovd", "description": "A robot's diagnoses and repairs for tools that read SOVD"},
    {"name": "drill", "description": "Faults that are planted on purpose, watched, and undone"},
    {"name": "moments", "description": "What was around a fault: freeze frame and recording"},
    {"name": "batches", "description": "Recorded logs, diagnosed in processes of their own"},
    {"name": "board", "description": "The power board's channels"},
    {"name": "agent", "description": "The robot's side of repair: it pulls actions and reports"},
    {"name": "control", "description": "The global stop, and quarantine"},
    {"name": "events", "description": "Server-sent events with replay"},
    {"name": "history", "description": "What was, and who did what and why"},
    {"name": "session", "description": "A browser's sign-in, for pages: bearer keys need none"},
    {"name": "one-shots", "description": "Stateless diagnoses and plans, what-if included"},
    {"name": "operation", "description": "Health, readiness, metrics, versions"},
]


def complete(document: dict[str, Any]) -> dict[str, Any]:
    """Name operations, add the schemes of key and cookie, give problems their media type; see to it that
    generated clients compile.
    """
    components = document.setdefault("components", {})
    components["schemas"]["ProblemBody"] = ProblemBody.model_json_schema()
    components["schemas"] |= COMPONENTS
    components["securitySchemes"] = {
        "key": {
            "type": "http",
            "scheme": "bearer",
            "description": "from `robomend keys create`; none is needed on loopback while no key exists",
        },
        "cookie": {
            "type": "apiKey",
            "in": "cookie",
            "name": PLAIN,
            "description": f"of a browser, from POST {API}/session; `{SECURE}` under TLS",
        },
    }
    for path, operations in document["paths"].items():
        for method, one in operations.items():
            # The function's name alone: generated clients call their methods so.
            place = re.sub(r"\W", "_", path)
            one["operationId"] = one["operationId"].removesuffix(f"{place}_{method}")
            if RULES.get((method.upper(), path)) is not EVERYONE:
                one["security"] = [{"key": []}, {"cookie": []}, {}]
            if len(one.get("requestBody", {}).get("content", {})) > 1:
                # Beside it: openapi-python-client imports what bodies of several kinds need for it only.
                one.setdefault("parameters", []).append(_REQUEST_ID)
            answers = one.get("responses", {})
            if method == "get" and "application/json" in answers.get("200", {}).get("content", {}):
                lists.describe(one)
                if path.startswith(API):  # robomend.api.edge
                    answers["200"].setdefault("headers", {})["ETag"] = _ETAG
                    answers["304"] = {
                        "description": "If-None-Match names this version: the client has it",
                        "headers": {"ETag": _ETAG},
                    }
            for code, response in answers.items():
                if code[0] in "45":
                    _as_problem(response)
            _optional(document, one.get("requestBody"), set())
    return document


_REQUEST_ID = {
    "name": "X-Request-ID",
    "in": "header",
    "required": False,
    "description": "by which the log and the answer name this request; without it the service makes one",
    "schema": {"type": "string", "maxLength": 200},
}


def _optional(document: dict[str, Any], schema: Any, seen: set[str]) -> None:
    """Say defaults of what is sent in words: to openapi-typescript, what has a default is always there."""
    if isinstance(schema, list):
        for part in schema:
            _optional(document, part, seen)
    if not isinstance(schema, dict):
        return
    named = str(schema.get("$ref", "")).removeprefix("#/components/schemas/")
    if named and named not in seen:
        seen.add(named)
        _optional(document, document["components"]["schemas"][named], seen)
    for property in (schema.get("properties") or {}).values():
        if isinstance(property, dict) and "default" in property:
            default = json.dumps(property.pop("default"), ensure_ascii=False)
            said = property.get("description", "")
            property["description"] = f"{said} (by default {default})".strip()
    for key, part in schema.items():
        if key not in ("example", "examples"):
            _optional(document, part, seen)


_ETAG = {
    "description": "the name of this version, for If-None-Match",
    "schema": {"type": "string"},
    "example": '"4f1d6a"',
}


def _as_problem(response: dict[str, Any]) -> None:
    """An error is a problem whatever the framework assumes; /readyz alone answers 503 with what is amiss."""
    told = [each for each in response.get("content", {}).values() if "schema" in each]
    if told and "Readiness" in str(told[0]["schema"]):
        response["content"] = {"application/json": told[0], MEDIA_TYPE: PROBLEM}
    elif told:
        response["content"] = {MEDIA_TYPE: told[0]}


ROUTERS = (
    observations,  # first, as routes are looked for in order and this is the busiest
    diagnosis,
    actions,
    robots,
    models,
    repairs,
    sovd,
    drills,
    moments,
    batches,
    board,
    control,
    events,
    history,
    notifications,
    oneshots,
    session,
    status,
    operation,
    docs,
    pages,
    robot_pages,
    model_pages,
    record_pages,
)

CONTROLLED = frozenset({f"{API}/stop", "/healthz", "/readyz"})
"""Paths that the control lane answers; see robomend.api.control_lane."""

UNTOLD: Any = {"tracing": False, "metrics": False, "logs": False}
"""The framework's own telemetry is off: ours is in the edge."""

Lifespan = Callable[[FastAPI], AbstractAsyncContextManager[None]]


def create_app(parts: Parts, *, lifespan: Lifespan | None = None) -> FastAPI:
    """Return the application over these parts; its `state.edge` is what a server serves.

    Args:
        parts: what it works with; started already, or started by `lifespan`.
        lifespan: what is around its life, e.g. starting the parts.
    """
    app = FastAPI(
        title="robomend",
        version=version_info()["robomend"] or "0",
        description=DESCRIPTION,
        openapi_tags=TAGS,
        docs_url=None,
        redoc_url=None,
        openapi_url=None,
        redirect_slashes=False,
        lifespan=lifespan or _nothing,
        telemetry=UNTOLD,
    )
    app.state.parts = parts
    app.state.gate = Admission(parts.store, parts.settings, parts.metrics)
    app.state.fleet = Fleet(parts.store, parts.robots.memory)
    app.state.pace = PagePace()
    app.state.pages = asyncio.Lock()
    problems.install(app)
    for module in ROUTERS:
        # Appended, not included: an included router is matched through a context of its own on every request.
        app.router.routes.extend(module.router.routes)
    busiest = next(route for route in routes(app) if route.endpoint is observations.post_observations)
    express = Express(parts, app.state.gate, busiest)
    # Around all of it, and not among the framework's layers, each of which passes every message on.
    app.state.edge = Edge(app, metrics=parts.metrics, express=express, shedding=parts.shedding)
    default_openapi = app.openapi
    document: dict[str, Any] = {}

    def openapi() -> dict[str, Any]:
        if not document:
            document.update(complete(default_openapi()))
        return document

    app.openapi = openapi  # type: ignore[method-assign]  # the way that FastAPI documents for extending it
    return app


def create_control_app(parts: Parts, gate: Admitter) -> Edge:
    """Return what the control lane answers with: the same routes for the stop, health and readiness.

    Args:
        gate: lets in without waiting for what may hang.
    """
    app = FastAPI(openapi_url=None, redirect_slashes=False, telemetry=UNTOLD)
    app.state.parts = parts
    app.state.gate = gate
    problems.install(app)
    for route in (*control.router.routes, *operation.router.routes):
        if isinstance(route, APIRoute) and route.path in CONTROLLED:
            app.router.routes.append(route)
    return Edge(app, metrics=parts.metrics, express=None, shedding=None, once=True)


def routes(app: FastAPI) -> list[APIRoute]:
    """Return the application's own routes, for tests and docs that walk them."""
    return [route for route in app.router.routes if isinstance(route, APIRoute)]


@asynccontextmanager
async def _nothing(_: FastAPI) -> AsyncIterator[None]:
    yield
