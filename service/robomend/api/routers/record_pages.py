"""/ui/repairs, drills, /ui/audit, /ui/keys, /ui/notifications, /ui/batches: what was, who did what and why,
whose keys there are, who is told, and what recorded logs showed.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import re
import time
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from markupsafe import Markup
from starlette.responses import Response

from robomend.api.batch_creation import create
from robomend.api.deps import (
    BatchPath,
    DrillPath,
    KeyPath,
    PagingDep,
    Parts,
    PartsDep,
    PrincipalDep,
    RepairPath,
    RobotPath,
)
from robomend.api.page_route import (
    HEADERS,
    PageRoute,
    back,
    check_ours,
    packed,
    page,
    read_form,
    reason_of,
    shell,
    wanted_parts,
)
from robomend.api.problems import Problem
from robomend.api.routers.notifications import tried
from robomend.api.schemas.base import NAME, one_line
from robomend.api.schemas.drill import DrillBody, DrillOut
from robomend.batches.record import OPEN
from robomend.drills.drills import DECISIONS
from robomend.drills.permission import board_of, nobody_for, obstacles
from robomend.drills.score import scored
from robomend.errors import NotFound, StateConflict
from robomend.repairs.record import LOOP
from robomend.repairs.states import RepairState
from robomend.robots.configuration import protection_of
from robomend.robots.declared import observables_at_hand
from robomend.security import ACT, Principal, Role, digest, new_key
from robomend.store import Transaction, View, api_keys, audit, diagnoses, models, notifications, repairs
from robomend.store.records import ApiKey, Paging
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
    """Show what could be planted on a robot, and its drills, newest first, with what became of each."""
    wanted = wanted_parts(request, ("stop", "plantable", "drills"))
    found = await parts.drills.drills(robot, before=paging.cursor, limit=paging.limit)
    drills = [DrillOut.model_validate(drill) for drill in found]
    values: dict[str, Any] = {"next": drills[-1].id if len(drills) == paging.limit else None}
    if "plantable" in wanted and principal.role in ACT:
        values |= await _plantable(parts, robot, found)
    around = shell(request, parts, principal, wanted)
    return await page(request, "drills.html", **around, **values, robot=robot, drills=drills)


PLAN_S = 10.0
"""For what each fault would show; of a large model the rest is left out, which is said."""


async def _plantable(parts: Parts, robot: str, held: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return what could be planted, with its promise and what its latest drill came to; what stands in the
    way of all of it; and why some never is.
    """
    state = await parts.robots.diagnosed(robot)
    config, model = state.config, state.system.parts
    if model is None:
        why = "the model is no component model: it does not say what could be planted"
        return {"faults": [], "refused": [], "obstacles": [why], "complete": True}
    agents = state.sight.declared.agents()
    faults, complete = await parts.one_shots.drill_plan(
        state.system,
        observables_at_hand(config, state.system, agents),
        protected=protection_of(config, model),
        board=board_of(config),
        meant_off=config.expected_stopped,
        timeout_s=PLAN_S,
    )
    shown: list[dict[str, Any]] = []
    refused: list[dict[str, str]] = []
    for fault in faults:
        if never := fault.refused or nobody_for(fault, agents):
            refused.append({"act": fault.act, "why": never})
            continue
        planned = {
            "kind": str(fault.kind),
            "component": fault.component,
            "topic": fault.topic,
            "promise": fault.promise,
            "shows": list(map(str, fault.shows)),
        }
        last = next((one for one in held if one["finished_ns"] and _of(one) == _of(planned)), None)
        score = None if last is None else scored(planned, last)
        shown.append({**planned, "act": fault.act, "undo": fault.undo, "score": score})
    way = list(obstacles(state))
    if any(one["finished_ns"] is None for one in held):
        way.append("a drill is under way")
    return {"faults": shown, "refused": refused, "obstacles": way, "complete": complete}


def _of(fault: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return which fault a planned one, or that of a drill, is."""
    return fault.get("kind") or fault.get("fault"), fault["component"], fault.get("topic")


@router.post("/ui/robots/{robot}/drills")
async def plant(request: Request, robot: RobotPath, parts: PartsDep, principal: PrincipalDep) -> Response:
    """Plant a fault, as POST /api/v1/robots/{robot}/drills does."""
    form = await read_form(request)
    await parts.drills.create(
        robot,
        fault=form.get("fault", ""),
        component=form.get("component") or None,
        topic=form.get("topic") or None,
        bound_s=DrillBody.model_fields["bound_s"].default,
        detect_s=DrillBody.model_fields["detect_s"].default,
        by=principal.name,
        reason=reason_of(form),
    )
    return back(f"/ui/robots/{robot}/drills")


@router.post("/ui/drills/{drill}")
async def decide_drill(
    request: Request, drill: DrillPath, parts: PartsDep, principal: PrincipalDep
) -> Response:
    """Cancel a drill, say that its person did what it waits for, or leave the rest to a person."""
    form = await read_form(request)
    decision = form.get("decision", "")
    if decision not in DECISIONS:
        raise Problem(422, f"the decision is one of {', '.join(DECISIONS)}")
    said = await parts.drills.decide(drill, decision, by=principal.name, reason=reason_of(form))
    return back(f"/ui/robots/{said['robot']}/drills")


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
        return seen, [one for one in noted if one.action.partition(".")[2] not in set(RepairState)]

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
    return await _keys(request, parts, principal)


async def _keys(
    request: Request, parts: Parts, principal: Principal, made: ApiKey | None = None, text: str = ""
) -> Response:
    """Return the page of keys; with the text of one that was made just now, as it is stored nowhere."""
    found = await parts.store.read(api_keys.every)
    around = shell(request, parts, principal, wanted_parts(request, ("stop",)))
    return await page(
        request, "keys.html", **around, keys=found, roles=list(Role), made=made, text=text, own=principal.key
    )


@router.post("/ui/keys")
async def make_key(request: Request, parts: PartsDep, principal: PrincipalDep) -> Response:
    """Make a key, and show its text: once, and to whoever has asked for it."""
    form = await read_form(request)
    robot, called = form.get("robot", "").strip() or None, one_line(form.get("name", "").strip())[:100]
    try:
        role = Role(form.get("role", ""))
    except ValueError:
        raise Problem(422, f"the role is one of {', '.join(Role)}") from None
    if (role is Role.ROBOT) != (robot is not None):
        raise Problem(422, "a robot is named with the role robot, and with no other: its key opens it alone")
    if robot is not None and re.match(NAME, robot) is None:
        raise Problem(422, f"{one_line(robot)[:64]!r} is no id of a robot, as in: tedusar-1")
    name, text, reason = called or (f"robot-{robot}" if robot else str(role)), new_key(), reason_of(form)

    def add(tx: Transaction) -> ApiKey:
        if role is not Role.ADMIN and not api_keys.every(tx):
            raise StateConflict("the first key is an admin's: from then on this page asks for one")
        key = api_keys.add(tx, name=name, hash=digest(text), role=role, robot=robot, by=principal.name)
        tx.note(api_keys.told("key.create", key, by=principal.name, reason=reason))
        return key

    made = await parts.store.write(add)
    request.app.state.gate.ring.forget()
    return await _keys(request, parts, principal, made, text)


@router.post("/ui/keys/{key}")
async def revoke_key(request: Request, key: KeyPath, parts: PartsDep, principal: PrincipalDep) -> Response:
    """Revoke a key; not the one that asks for it, so that an admin is left who can make others."""
    reason = reason_of(await read_form(request))
    if key == principal.key:
        raise Problem(409, "this is the key that you are signed in with: revoke it with another one")

    def revoke(tx: Transaction) -> None:
        if all(one.id != key or one.revoked_ns is not None for one in api_keys.every(tx)):
            raise NotFound(f"no key in use has the id {key!r}")
        gone = api_keys.revoke(tx, key)
        tx.note(api_keys.told("key.revoke", gone, by=principal.name, reason=reason))

    await parts.store.write(revoke)
    request.app.state.gate.ring.forget()
    return back("/ui/keys")


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


# --- /ui/batches: the batches, a form to hand one in, and each with its progress and its report


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
