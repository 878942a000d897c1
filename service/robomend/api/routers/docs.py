"""/docs: the API's page, which asks nobody but this service, so that it works on a robot without internet.

The page of /docs: Swagger UI, vendored in static/ with its licence.
FastAPI's own page loads from a CDN.
"""

from __future__ import annotations

import asyncio
import json
import pathlib
from dataclasses import dataclass
from typing import Annotated

from fastapi import APIRouter, Path, Request, Response
from starlette.responses import FileResponse, HTMLResponse

from robomend.api.gate import GuardedRoute
from robomend.api.problems import problems
from robomend.errors import NotFound

STATIC = pathlib.Path(__file__).resolve().parents[1] / "static"


@dataclass(frozen=True, slots=True)
class StaticFile:
    """A file that ships with the package."""

    path: pathlib.Path
    media_type: str


FILES = {
    "swagger-ui.css": StaticFile(STATIC / "swagger-ui.css", "text/css"),
    "swagger-ui-bundle.js": StaticFile(STATIC / "swagger-ui-bundle.js", "text/javascript"),
    "start.js": StaticFile(STATIC / "start.js", "text/javascript"),
}

PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>robomend: HTTP interface</title>
<link rel="icon" href="data:,">
<link rel="stylesheet" href="docs/swagger-ui.css">
</head>
<body>
<div id="api"></div>
<script src="docs/swagger-ui-bundle.js"></script>
<script src="docs/start.js"></script>
</body>
</html>
"""


router = APIRouter(route_class=GuardedRoute, include_in_schema=False)


@router.get("/openapi.json", responses=problems())
async def document(request: Request) -> Response:
    """Return the OpenAPI document."""
    state = request.app.state
    if not hasattr(state, "openapi_text"):  # a fifth of a second of work, once
        state.openapi_text = await asyncio.to_thread(lambda: json.dumps(request.app.openapi()).encode())
    return Response(state.openapi_text, media_type="application/json")


@router.get("/docs", responses=problems())
async def page() -> HTMLResponse:
    """Return the page."""
    return HTMLResponse(PAGE, headers={"Content-Security-Policy": "default-src 'self' 'unsafe-inline' data:"})


@router.get("/docs/{file}", responses=problems(404))
async def asset(file: Annotated[str, Path(max_length=64)]) -> FileResponse:
    """Return a file of the page."""
    found = FILES.get(file)
    if found is None:
        raise NotFound(f"the docs page has no file {file[:64]!r}")
    return FileResponse(found.path, media_type=found.media_type, headers={"Cache-Control": "max-age=86400"})
