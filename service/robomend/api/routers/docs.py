"""/docs: the API's page, which asks nobody but this service, so that it works on a robot without internet."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse

from robomend.api.docs_page import FILES, PAGE
from robomend.api.documented import problems
from robomend.api.gate import GuardedRoute
from robomend.errors import NotFound

router = APIRouter(route_class=GuardedRoute, include_in_schema=False)


@router.get("/openapi.json", responses=problems())
async def document(request: Request) -> JSONResponse:
    """Return the OpenAPI document."""
    return JSONResponse(request.app.openapi())


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
