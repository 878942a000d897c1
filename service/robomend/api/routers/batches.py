"""/batches: recorded logs, diagnosed in processes of their own; durable, bounded, cancelled by DELETE."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request, Response
from starlette.responses import FileResponse

from robomend.api.batch_creation import OPENAPI_BODY, BatchOut, create
from robomend.api.deps import BatchPath, PagingDep, PartsDep, PrincipalDep, ReasonQuery
from robomend.api.gate import GuardedRoute
from robomend.api.problems import problems
from robomend.api.schemas.base import Items
from robomend.security import API

router = APIRouter(prefix=f"{API}/batches", tags=["batches"], route_class=GuardedRoute)

MEDIA_TYPES = {
    "ndjson": "application/x-ndjson",
    "logs": "application/x-ndjson",
    "parquet": "application/vnd.apache.parquet",
    "report": "text/html; charset=utf-8",
}

REPORT_POLICY = (
    "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'; "
    "base-uri 'none'; form-action 'none'"
)
"""The report shows texts of logs: it gets an origin of its own, no script, and asks nobody for anything."""

FILES: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The results",
        "content": {kind.partition(";")[0]: {"schema": {"type": "string"}} for kind in MEDIA_TYPES.values()},
    }
}


@router.post("", status_code=202, responses=problems(404, body=True), openapi_extra=OPENAPI_BODY)
async def create_batch(
    request: Request, parts: PartsDep, principal: PrincipalDep, response: Response
) -> BatchOut:
    """Diagnose logs: uploaded ones (a form), or some below the setting `batch_folder` (JSON)."""
    made = BatchOut.model_validate(await create(request, parts, principal))
    response.headers["Location"] = f"{API}/batches/{made.id}"
    return made


@router.get("", responses=problems())
async def list_batches(parts: PartsDep, paging: PagingDep) -> Items[BatchOut]:
    """List batches, newest first: of all instances, each with the computer that has its files."""
    page = await parts.batches.page(paging)
    return Items(items=[BatchOut.model_validate(one) for one in page.items], next=page.next)


@router.get("/{batch}", responses=problems(404))
async def get_batch(batch: BatchPath, parts: PartsDep) -> BatchOut:
    """Return a batch: what was asked for, and how far it is."""
    return BatchOut.model_validate(await parts.batches.batch(batch))


@router.get("/{batch}/result", response_class=FileResponse, responses={**problems(404, 409), **FILES})
async def batch_result(
    batch: BatchPath,
    parts: PartsDep,
    format: Annotated[
        Literal["ndjson", "logs", "parquet", "report"],
        Query(description="the intervals (ndjson, parquet), a line for each log, or the report in HTML"),
    ] = "ndjson",
) -> FileResponse:
    """Return what the logs of a batch show; a conflict while it has not ended."""
    file = await parts.batches.result(batch, format)
    headers = {"Content-Security-Policy": REPORT_POLICY} if format == "report" else {}
    return FileResponse(file, headers=headers, media_type=MEDIA_TYPES[format])


@router.delete("/{batch}", responses=problems(404, 409))
async def cancel_batch(
    batch: BatchPath, parts: PartsDep, principal: PrincipalDep, reason: ReasonQuery = ""
) -> BatchOut:
    """Cancel a batch: its processes are ended. A conflict if it has ended already."""
    return BatchOut.model_validate(await parts.batches.cancel(batch, by=principal.name, reason=reason))
