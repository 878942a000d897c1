"""/ui/batches: the batches, a form to hand one in, and each with its progress and its report."""

from __future__ import annotations

from fastapi import APIRouter, Request
from starlette.responses import Response

from robomend.api.batch_creation import create
from robomend.api.deps import BatchPath, PagingDep, PartsDep, PrincipalDep
from robomend.api.page_route import (
    PageRoute,
    back,
    check_ours,
    page,
    read_form,
    reason_of,
    shell,
    wanted_parts,
)
from robomend.batches.record import BatchState
from robomend.store import models
from robomend.store.records import Paging

router = APIRouter(route_class=PageRoute, include_in_schema=False)

OPEN = (BatchState.WAITING, BatchState.RUNNING)


@router.get("/ui/batches")
async def batches_page(
    request: Request, parts: PartsDep, principal: PrincipalDep, paging: PagingDep
) -> Response:
    """List the batches, newest first."""
    wanted = wanted_parts(request, ("stop", "batches"))
    found = await parts.batches.page(paging) if "batches" in wanted else None
    around = shell(request, parts, principal, wanted)
    known = await parts.store.read(models.page, Paging(limit=1000)) if not around["fragment"] else None
    return await page(
        request,
        "batches.html",
        **around,
        found=found,
        cursor=paging.cursor,
        open_states=OPEN,
        models=[model.name for model in known.items] if known else [],
        folder=parts.settings.batch_folder,
    )


@router.post("/ui/batches")
async def create_batch(request: Request, parts: PartsDep, principal: PrincipalDep) -> Response:
    """Hand in logs, as a form."""
    check_ours(request)
    made = await create(request, parts, principal, page=True)
    return back(f"/ui/batches/{made['id']}")


@router.get("/ui/batches/{batch}")
async def batch_page(
    request: Request, batch: BatchPath, parts: PartsDep, principal: PrincipalDep
) -> Response:
    """Show one batch: how far it is, and the way to its results."""
    wanted = wanted_parts(request, ("stop", "batch"))
    around = shell(request, parts, principal, wanted)
    found = await parts.batches.batch(batch)
    return await page(request, "batch.html", **around, one=found, open_states=OPEN)


@router.post("/ui/batches/{batch}")
async def cancel_batch(
    request: Request, batch: BatchPath, parts: PartsDep, principal: PrincipalDep
) -> Response:
    """Cancel a batch, as a form."""
    form = await read_form(request)
    await parts.batches.cancel(batch, by=principal.name, reason=reason_of(form))
    return back(f"/ui/batches/{batch}")
