"""/ui/benchmarks: the reports of robomend-bench that lie in a folder of the service's computer."""

from __future__ import annotations

import asyncio
from pathlib import Path as Folder
from typing import Annotated

from fastapi import APIRouter, Path, Request
from starlette.responses import Response

from robomend.api.deps import PartsDep, PrincipalDep
from robomend.api.page_route import PageRoute, packed, page, shell, wanted_parts
from robomend.errors import NotFound
from robomend.web import benchmark_reports

router = APIRouter(route_class=PageRoute, include_in_schema=False)

PICTURE = {"Content-Security-Policy": "default-src 'none'; sandbox", "Cache-Control": "no-store"}
"""A picture that is opened by itself is a document, and may do no more than before."""

Named = Annotated[str, Path(pattern=benchmark_reports.NAME)]


@router.get("/ui/benchmarks")
async def benchmarks_page(request: Request, parts: PartsDep, principal: PrincipalDep) -> Response:
    """List the reports, newest first."""
    folder = parts.settings.benchmark_folder
    there = folder is not None and folder.is_dir()
    found = await asyncio.to_thread(benchmark_reports.entries, folder) if folder and there else []
    around = shell(request, parts, principal, wanted_parts(request, ("stop",)))
    return await page(request, "benchmarks.html", **around, found=found, folder=folder, there=there)


@router.get("/ui/benchmarks/{report}")
async def benchmark_page(
    request: Request, report: Named, parts: PartsDep, principal: PrincipalDep
) -> Response:
    """Show one report with its plots."""
    folder = _folder(parts.settings.benchmark_folder)
    found = await asyncio.to_thread(benchmark_reports.report, folder, report)
    if found is None:
        raise NotFound(f"there is no report {report!r} of a benchmark that can be shown")
    around = shell(request, parts, principal, wanted_parts(request, ("stop",)))
    return await page(request, "benchmark.html", **around, report=found)


@router.get("/ui/benchmarks/plots/{plot}")
async def benchmark_plot(request: Request, plot: Named, parts: PartsDep) -> Response:
    """Return a plot, which is a picture."""
    found = None
    if plot.endswith(".svg"):
        folder = _folder(parts.settings.benchmark_folder)
        found = await asyncio.to_thread(benchmark_reports.content, folder, plot)
    if found is None:
        raise NotFound(f"there is no plot {plot!r}")
    return packed(request, found, "image/svg+xml", PICTURE)


def _folder(folder: Folder | None) -> Folder:
    if folder is None:
        raise NotFound("the setting benchmark_folder names no folder of reports")
    return folder
