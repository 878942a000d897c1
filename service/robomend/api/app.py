"""`create_app`: the parts go in, an ASGI application comes out. No module-level app: two live in one process.

    edge (ids, Origin, log) ──► gate (key or Host, role, rate) ──► router ──► robots, repairs, store

The parts are started and closed by whoever made them (see robomend.api.runtime), not by the application.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any

from fastapi import FastAPI
from fastapi.routing import APIRoute

from robomend.api import problems
from robomend.api.deps import Parts
from robomend.api.edge import Edge
from robomend.api.express import Express
from robomend.api.gate import Admission, Admitter
from robomend.api.openapi import DESCRIPTION, TAGS, complete
from robomend.api.page_route import PagePace
from robomend.api.routers import (
    actions,
    batch_pages,
    batches,
    benchmark_pages,
    board,
    control,
    diagnosis,
    docs,
    drills,
    events,
    history,
    model_pages,
    model_reports,
    models,
    notifications,
    observations,
    oneshots,
    operation,
    pages,
    plans,
    record_pages,
    repairs,
    robot_pages,
    robots,
    root,
    session,
    sovd,
    status,
)
from robomend.security import API
from robomend.version import version_info
from robomend.web.fleet import Fleet

ROUTERS = (
    observations,  # first, as routes are looked for in order and this is the busiest
    diagnosis,
    actions,
    robots,
    models,
    plans,
    repairs,
    sovd,
    drills,
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
    root,
    docs,
    pages,
    robot_pages,
    model_pages,
    model_reports,
    record_pages,
    batch_pages,
    benchmark_pages,
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
