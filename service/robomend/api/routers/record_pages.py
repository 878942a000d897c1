"""/ui/repairs, drills, /ui/audit, /ui/keys, /ui/notifications: what was, who did what and why, whose keys
there are, and who is told.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import time
from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from markupsafe import Markup
from starlette.responses import Response

from robomend.api.deps import PagingDep, PartsDep, PrincipalDep, RepairPath, RobotPath
from robomend.api.page_route import (
    HEADERS,
    PageRoute,
    back,
    packed,
    page,
    read_form,
    shell,
    wanted_parts,
)
from robomend.api.routers.notifications import tried
from robomend.api.schemas.base import NAME
from robomend.api.schemas.drill import DrillOut
from robomend.repairs.record import LOOP
from robomend.store import View, api_keys, audit, diagnoses, notifications, repairs
from robomend.store.records import Paging
from robomend.web import past
from robomend.web import timeline as figure
from robomend.web.rendering import render
from robomend.web.words import folded

router = APIRouter(route_class=PageRoute, include_in_schema=False)


@router.get("/ui/repairs")
async def repairs_page(
    request: Request,
    parts: PartsDep,
    principal: PrincipalDep,
    paging: PagingDep,
    robot: Annotated[str | None, Query(pattern=NAME)] = None,
) -> Response:
    """List the repairs of all robots or of one, newest first."""
    wanted = wanted_parts(request, ("stop", "repairs"))
    found = await parts.store.read(repairs.page, robot, paging) if "repairs" in wanted else None
    around = shell(request, parts, principal, wanted)
    return await page(request, "repairs.html", **around, found=found, of_robot=robot, cursor=paging.cursor)


@router.get("/ui/robots/{robot}/drills")
async def drills_page(
    request: Request, robot: RobotPath, parts: PartsDep, principal: PrincipalDep, paging: PagingDep
) -> Response:
    """List a robot's drills, newest first, with what became of each."""
    found = await parts.drills.drills(robot, before=paging.cursor, limit=paging.limit)
    drills = [DrillOut.model_validate(drill) for drill in found]
    older = drills[-1].id if len(drills) == paging.limit else None
    around = shell(request, parts, principal, wanted_parts(request, ("stop", "drills")))
    return await page(request, "drills.html", **around, robot=robot, drills=drills, next=older)


@router.get("/ui/audit")
async def audit_page(
    request: Request,
    parts: PartsDep,
    principal: PrincipalDep,
    paging: PagingDep,
    robot: Annotated[str, Query(pattern=f"^$|{NAME}")] = "",
    who: Annotated[str, Query(pattern="^(people)?$")] = "",
) -> Response:
    """Show who did what, when and why, newest first; `people`: without what the service and robots did."""
    without = (LOOP, "observations.report") if who else ()
    found = await parts.store.read(
        lambda view: audit.page(view, paging, robot=robot or None, without=without)
    )
    around = shell(request, parts, principal, wanted_parts(request, ("stop",)))
    lines = folded(found.items, LOOP)
    return await page(request, "audit.html", **around, lines=lines, next=found.next, of_robot=robot, who=who)


REPORT_DIAGNOSES, REPORT_AUDIT = 300, 100
"""What is drawn and listed in a report; a repair of more is told with its newest."""


@router.get("/ui/repairs/{repair}/report")
async def report_of_repair(
    request: Request, repair: RepairPath, parts: PartsDep, principal: PrincipalDep, download: bool = False
) -> Response:
    """Return a repair as one file without links: what was seen, decided, and done, and what came of it."""
    found = await parts.repairs.repair(repair)
    robot = found["robot"]
    end_ns = found["finished_ns"] or time.time_ns()
    start_ns = min([found["created_ns"], *_onsets(found)]) - AROUND_NS

    def look(view: View) -> tuple[Any, ...]:
        seen, _ = diagnoses.between(view, robot, start_ns, end_ns + AROUND_NS, REPORT_DIAGNOSES)
        paging = Paging(limit=REPORT_AUDIT)
        noted = audit.page(view, paging, robot=robot, subject=repair, without=(LOOP,)).items
        return seen, noted

    seen, people = await parts.store.read(look)
    drawn = past.timeline(robot, start_ns, end_ns + AROUND_NS, seen, [found])
    figure_ = Markup(figure.svg(drawn)) if drawn.rows or drawn.actions else None  # it escapes what it shows
    text = await asyncio.to_thread(
        render,
        "report.html",
        repair=found,
        robot=robot,
        people=people[::-1],
        figure=figure_,
        made_ns=time.time_ns(),
    )
    style = text.partition("<style>")[2].partition("</style>")[0]
    allowed = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode()
    headers = {
        **HEADERS,
        "Content-Security-Policy": f"default-src 'none'; style-src 'sha256-{allowed}'",
        "Content-Disposition": f'{"attachment" if download else "inline"}; filename="{repair}.html"',
    }
    return packed(request, text.encode(), "text/html; charset=utf-8", headers)


AROUND_NS = 5 * 10**9
"""What is drawn before a repair's first symptom and after its end."""


def _onsets(repair: Mapping[str, Any]) -> list[int]:
    """Return since when the symptoms of a repair are so, as far as that is within the hour before it."""
    symptoms = (one for done in repair["rounds"] for one in done.get("symptoms") or ())
    found = (one.get("onset_ns") or one.get("since_ns") or repair["created_ns"] for one in symptoms)
    return [at for at in found if repair["created_ns"] - at < 3600 * 10**9]


@router.get("/ui/keys")
async def keys_page(request: Request, parts: PartsDep, principal: PrincipalDep) -> Response:
    """List the keys, revoked ones included; never their text."""
    found = await parts.store.read(api_keys.every)
    around = shell(request, parts, principal, wanted_parts(request, ("stop",)))
    return await page(request, "keys.html", **around, keys=found)


@router.get("/ui/notifications")
async def notifications_page(
    request: Request, parts: PartsDep, principal: PrincipalDep, paging: PagingDep
) -> Response:
    """Show who is told that a person is needed, and what they were told."""
    found = await parts.store.read(notifications.page, paging)
    around = shell(request, parts, principal, wanted_parts(request, ("stop",)))
    recipients = list(parts.notifier.recipients.values())
    public_url = parts.settings.public_url
    return await page(
        request,
        "notifications.html",
        **around,
        found=found,
        recipients=recipients,
        public_url=public_url,
    )


@router.post("/ui/notifications")
async def test_notification(request: Request, parts: PartsDep, principal: PrincipalDep) -> Response:
    """Send a recipient a test, and show what came of it."""
    form = await read_form(request)
    await tried(parts, form.get("recipient", ""), principal.name)
    return back("/ui/notifications")
