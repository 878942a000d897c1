"""/: what people see of all robots; signing in and out, and the global stop, as forms that need no script;
the reports of benchmarks.
"""

from __future__ import annotations

import asyncio
from pathlib import Path as Folder
from typing import Annotated
from urllib.parse import urlsplit

from fastapi import APIRouter, Path, Query, Request
from starlette.responses import Response

from robomend.api.deps import PartsDep, PrincipalDep
from robomend.api.gate import Admission
from robomend.api.page_route import PageRoute, back, packed, page, read_form, reason_of, shell, wanted_parts
from robomend.api.problems import Problem
from robomend.api.routers.control import ANSWER_S
from robomend.errors import NotFound
from robomend.repairs.stop_switch import written
from robomend.web import benchmark_reports
from robomend.web.rendering import MOST_ROWS, ROWS, static_files, static_version

router = APIRouter(route_class=PageRoute, include_in_schema=False)

KEPT = {"Cache-Control": "public, max-age=31536000, immutable", "Vary": "Accept-Encoding"}
"""The address of a file changes with its content."""

NOT_KEPT = {"Cache-Control": "no-store", "Vary": "Accept-Encoding"}
"""Of a page that was made by another version of the service."""

LIFTED_S = 2.0
"""A stop is lifted when that is on disk, and the page that comes next shows whether it is; so it waits for so
long. A stop that is set is in force at once."""


@router.get("/")
async def fleet_page(
    request: Request,
    parts: PartsDep,
    principal: PrincipalDep,
    q: Annotated[str, Query(max_length=200)] = "",
    state: Annotated[str, Query(max_length=20)] = "",
    number: Annotated[int, Query(alias="page", ge=1, le=1_000_000)] = 1,
    rows: Annotated[int, Query(ge=1, le=MOST_ROWS)] = ROWS,
) -> Response:
    """Show every robot: how it is, what is wrong, what it waits for."""
    wanted = wanted_parts(request, ("stop", "fleet"))
    fleet = request.app.state.fleet
    found = await fleet.page(search=q, state=state, number=number, rows=rows) if "fleet" in wanted else None
    return await page(
        request,
        "fleet.html",
        **shell(request, parts, principal, wanted),
        found=found,
        q=q,
        state=state,
        rows=rows,
    )


@router.get("/ui/sign-in")
async def sign_in_page(request: Request, to: Annotated[str, Query(max_length=2000)] = "/") -> Response:
    """Ask for a key."""
    return await page(request, "sign_in.html", to=ours(to), problem=None, told=False)


@router.post("/ui/sign-in")
async def sign_in(request: Request) -> Response:
    """Sign a browser in with a key, and go where it wanted to."""
    form = await read_form(request, 4096)
    gate: Admission = request.app.state.gate
    to = ours(form.get("to", "/"))
    try:
        _, cookie = await gate.sign_in(request, form.get("key", "").strip())
    except Problem as problem:
        return await page(request, "sign_in.html", problem.status, to=to, problem=problem, told=True)
    answer = back(to)
    answer.headers.append("Set-Cookie", cookie)
    return answer


@router.post("/ui/sign-out")
async def sign_out(request: Request) -> Response:
    """Sign the browser out."""
    await read_form(request)
    answer = back("/ui/sign-in")
    gate: Admission = request.app.state.gate
    await gate.sign_ins.end(request, answer)
    return answer


@router.post("/ui/stop")
async def stop(request: Request, parts: PartsDep, principal: PrincipalDep) -> Response:
    """Set or lift the global stop, without scripts; see POST /api/v1/stop."""
    form = await read_form(request)
    active = form.get("active") != "no"
    change = parts.repairs.switch.ask(active, by=principal.name, reason=reason_of(form))
    await written(change, ANSWER_S if active else LIFTED_S)
    return back(ours(form.get("to", "/")))


@router.get("/ui/static/{version}/{file}")
async def static_file(
    request: Request,
    version: Annotated[str, Path(max_length=64)],
    file: Annotated[str, Path(max_length=64)],
) -> Response:
    """Return a file that pages ask for."""
    found = static_files().get(file)
    if found is None:
        raise NotFound(f"the page has no file {file[:64]!r}")
    return packed(request, *found, KEPT if version == static_version() else NOT_KEPT)


def ours(address: str) -> str:
    """Return an address of this service to go to; any other is the first page."""
    there = urlsplit(address)
    if there.scheme or there.netloc or not address.startswith("/") or "\\" in address:
        return "/"
    return address if address.isprintable() and (there.path == "/" or there.path.startswith("/ui/")) else "/"


# --- /ui/benchmarks: the reports of robomend-bench that lie in a folder of the service's computer


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
