"""/ui/repairs, drills, /ui/audit, /ui/keys, /ui/notifications: what was, who did what and why, whose keys
there are, and who is told.
"""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from robomend.api.deps import PagingDep, PartsDep, PrincipalDep, RobotPath
from robomend.api.page_route import PageRoute, back, page, read_form, shell, wanted_parts
from robomend.api.routers.notifications import tried
from robomend.api.schemas.base import NAME
from robomend.api.schemas.drill import DrillOut
from robomend.store import api_keys, audit, notifications, repairs

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
    robot: Annotated[str | None, Query(pattern=NAME)] = None,
) -> Response:
    """Show who did what, when and why, newest first."""
    found = await parts.store.read(lambda view: audit.page(view, paging, robot=robot))
    around = shell(request, parts, principal, wanted_parts(request, ("stop",)))
    return await page(request, "audit.html", **around, found=found, of_robot=robot)


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
