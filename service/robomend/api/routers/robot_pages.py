"""/ui/robots/{robot}: what people see of one robot, and what they may do to it, as forms."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Request
from markupsafe import Markup
from starlette.responses import Response

from robomend.api.deps import MomentPath, Parts, PartsDep, PrincipalDep, RepairPath, RobotPath
from robomend.api.gate import reporter_of
from robomend.api.page_route import PageRoute, back, page, read_form, reason_of, shell, wanted_parts
from robomend.api.problems import Problem
from robomend.api.routers.moments import moment_out
from robomend.api.schemas.observations import ObservedLiteral, ObsOut
from robomend.api.views import board_out, obs_out
from robomend.errors import RobomendError
from robomend.model.answers import asks_of_arrow, questions_of
from robomend.model.from_graph import arrow_question
from robomend.model.vocabulary import ACTIVE
from robomend.repairs.foresight import doubts
from robomend.repairs.headline import of_robot
from robomend.robots.batches import Batch
from robomend.robots.clock import CLOCK
from robomend.robots.health import HealthState, health_of
from robomend.robots.robot import Robot
from robomend.store import View, diagnoses, drills, moments
from robomend.store.records import Paging, StoredDiagnosis, StoredMoment
from robomend.web import graph, past
from robomend.web import timeline as figure
from robomend.web.moment_plot import sparkline
from robomend.web.suspicion import Suspicion, suspicions, whys, with_priors
from robomend_client.literals import Atom, parse_atom

router = APIRouter(route_class=PageRoute, include_in_schema=False)

PARTS = ("stop", "state", "repair", "diagnosis", "findings", "moments", "graph", "obs", "board", "past")
"""Parts of the page, in its order."""

PROBES = 5
SHOWN_OBS = 500
DIAGNOSES = 10
REPAIRS = 20
MOMENTS = 6
DRAWN = 1000
"""Components of a model whose graph is drawn."""
BEFORE_NS = 120 * 10**9
"""A moment that came so long before a repair began is of what it repairs."""

PAST = 300
"""Diagnoses drawn in one timeline."""

USUAL_S = 600
SPANS_S = {60: "1 min", 600: "10 min", 3600: "1 h", 86400: "1 day"}


@router.get("/ui/robots/{robot}")
async def robot_page(
    request: Request,
    robot: RobotPath,
    parts: PartsDep,
    principal: PrincipalDep,
    until: Annotated[int | None, Query(ge=0, le=10**14, description="of the timeline, ms")] = None,
    span: Annotated[int | None, Query(ge=1, le=31 * 86400, description="of the timeline, s")] = None,
    plan: bool = False,
) -> Response:
    """Show a robot: how it is and why, its repair, OBS, the board, and its past."""
    wanted = wanted_parts(request, PARTS)
    state = await parts.robots.diagnosed(robot)
    values: dict[str, Any] = {"robot": robot, "spans": SPANS_S}
    values |= _of_diagnosis(state)
    if "state" in wanted or "repair" in wanted:
        newest = await parts.repairs.repairs(robot, before=None, limit=REPAIRS)
        values |= {"repair": newest[0] if newest else None, "repairs": newest}
        values["headline"] = of_robot(state, values["repair"])
    if "findings" in wanted:
        values["findings"] = await parts.repairs.findings(robot)
    if "state" in wanted:
        values["quarantine"] = await parts.repairs.quarantined(robot)
        if state.stored.model is not None:
            model, _ = await parts.robots.models.current(state.stored.model)
            values["questions"] = questions_of(model.source)
            values["arrows"] = await parts.store.read(partial(_contradicted, state, model.source, newest))
    if "repair" in wanted:
        values |= await _planned(parts, robot) if plan else {"planned": None, "no_plan": ""}
    if "diagnosis" in wanted:
        values |= await _probes(parts, state)
    if "moments" in wanted:
        values |= await parts.store.read(_newest_moments, robot)
    if "graph" in wanted:
        values["graph"] = await asyncio.to_thread(_graph, state, values["found"], values["whys"])
    if "obs" in wanted:
        shown = _by_one_clock(obs_out(state), state)
        values |= {"most": SHOWN_OBS, **_sorted(shown, state)}
        values["courses"] = _courses(state, shown.observations[:SHOWN_OBS])
    if "board" in wanted:
        wired = None if state.config.board is None else await parts.robots.board(robot)
        values["board"] = None if wired is None else board_out(wired)
    if "past" in wanted:
        values |= await _past(parts, state, until, span)
    return await page(request, "robot.html", **shell(request, parts, principal, wanted), **values)


def _contradicted(
    state: Robot, source: str, newest: Sequence[Mapping[str, Any]], view: View
) -> list[tuple[str, str]]:
    """Return the arrows of the model that are contradicted by what is known, or were in a repair or a drill:
    each with the question that is asked of it, or nothing where the text must be changed by hand.
    """
    found = doubts(state.system.parts, state.sight.entries())
    for repair in newest:
        found += repair["doubts"]
    for drill in drills.page(view, state.id, Paging(limit=REPAIRS)).items:
        found += (drill.data.get("seen") or {}).get("doubts", ())
    nodes = state.system.parts.nodes if state.system.parts is not None else {}
    shown = {}
    for one in found:
        topic, given = one["topic"], one["input"]
        if one["node"] in nodes and given in nodes[one["node"]].publishes.get(topic, ()):
            asks = asks_of_arrow(source, topic, given)
            shown[one["text"]] = arrow_question(topic, given) if asks else ""
    return list(shown.items())


def _of_diagnosis(state: Robot) -> dict[str, Any]:
    """Return what the templates need of the diagnosis, whichever part they make."""
    current = state.current
    result = None if current is None else current.result
    health, unknown = health_of(state)
    # Of a robot of which nothing is known, nothing is good either.
    said = None if health is HealthState.UNKNOWN else result
    found = suspicions(state.system.cnf.components, said)
    if not health.faulty:
        found |= dict.fromkeys(_unseen(state, unknown), Suspicion("unknown"))
    return {
        "health": str(health),
        "unknown": [str(atom) for atom in unknown],
        "config": state.config,
        "model": state.stored.model,
        "revision": state.revision,
        "current": current,
        "result": result,
        "found": found,
        "whys": whys(found, result),
        "priors": with_priors(result),
        "most_diagnoses": DIAGNOSES,
        "functions": state.function_states(),
    }


def _unseen(state: Robot, unknown: Sequence[Atom]) -> Iterator[str]:
    """Yield the components of which something is not known: nobody has seen that they are good."""
    names = {name for atom in unknown for name in atom.args}
    nodes = {} if state.system.parts is None else state.system.parts.nodes
    for component in state.system.cnf.components:
        topics = nodes[component].publishes if component in nodes else ()
        if component in names or names.intersection(topics):
            yield component


def _newest_moments(view: View, robot: str) -> dict[str, Any]:
    """Return the newest moment, and those before it."""
    return _told_moments(view, moments.page(view, robot, Paging(limit=MOMENTS)).items)


def _told_moments(view: View, found: Sequence[StoredMoment]) -> dict[str, Any]:
    newest = moment_out(view, found[0].id) if found else None
    return {"moment": newest, "older": found[1:]}


async def _planned(parts: Parts, robot: str) -> dict[str, Any]:
    """Return a plan that nobody carries out, or why there is none."""
    try:
        found = await parts.repairs.plan(robot, bad=None, planner=None, timeout_s=10.0, pddl=False)
    except RobomendError as error:
        return {"planned": None, "no_plan": str(error)}
    return {"planned": found, "no_plan": ""}


async def _probes(parts: Parts, state: Robot) -> dict[str, Any]:
    """Return what to look at next; a robot that nothing is wrong with needs none."""
    if state.current is None or state.current.result is None or len(state.current.result["diagnoses"]) < 2:
        return {"probes": (), "no_probes": ""}
    try:
        found = await parts.one_shots.probes(*state.question(), state.config.engine, PROBES)
    except RobomendError as error:  # busy, or too large a model: the page goes without
        return {"probes": (), "no_probes": str(error)}
    named = [
        {
            "atom": str(probe.atom),
            "gain_bits": probe.gain_bits,
            "cost_s": probe.cost_s,
            "if_true": [list(found.diagnoses[index]) for index in probe.if_true],
            "if_false": [list(found.diagnoses[index]) for index in probe.if_false],
        }
        for probe in found.probes
    ]
    return {"probes": named, "no_probes": "" if named else found.reason or ""}


def _graph(state: Robot, found: Mapping[str, Any], explained: Any) -> Markup | None:
    """Return the component graph, None for a model that says nothing of what feeds what."""
    model = state.system.parts
    if model is None or len(model.components) > DRAWN:
        return None
    seen = {
        literal.atom.args[0]: literal.positive
        for literal in state.literals()
        if literal.atom.predicate == "ok" and len(literal.atom.args) == 1
    }
    links = {why.component: f"#why-{index}" for index, why in enumerate(explained)}
    active = {
        literal.atom.args[0]: literal.atom.args[1]
        for literal in (state.literals() if model.functions else ())
        if literal.atom.predicate == ACTIVE and literal.positive
    }
    # The graph escapes what it shows.
    return Markup(graph.svg(graph.layout(model), found, seen, links, active))


def _by_one_clock(obs: ObsOut, state: Robot) -> ObsOut:
    """Return OBS with its times by this computer's clock, as all else on the page has them."""
    told_ns, ahead_ns = state.sight.told_ns, CLOCK.ahead_ns

    def dated(one: ObservedLiteral) -> ObservedLiteral:
        said_ns = told_ns(one.source, one.time_ns)
        since_ns = None if one.since_ns is None else min(one.since_ns - ahead_ns, said_ns)
        return one.model_copy(update={"time_ns": said_ns, "since_ns": since_ns})

    return obs.model_copy(
        update={
            "observations": [dated(one) for one in obs.observations],
            "assertions": [
                each.model_copy(update={"time_ns": told_ns(each.source, each.time_ns)})
                for each in obs.assertions
            ],
        }
    )


def _sorted(obs: ObsOut, state: Robot) -> dict[str, Any]:
    """Return OBS as people look at it: what is amiss or in doubt, bad first, and the rest by component.

    Without the variants that are not the active ones.
    """
    nodes = {} if state.system.parts is None else state.system.parts.nodes
    publisher = {topic: node.name for node in nodes.values() for topic in node.publishes}
    amiss: list[ObservedLiteral] = []
    good: dict[str, list[ObservedLiteral]] = {}
    for one in obs.observations[:SHOWN_OBS]:
        atom = parse_atom(one.literal.removeprefix("not "))
        positive = not one.literal.startswith("not ")
        if atom.predicate == ACTIVE and not positive:
            continue
        if one.fresh and one.confirmed and positive:
            name = atom.args[0] if atom.args else atom.predicate
            good.setdefault(publisher.get(name, name), []).append(one)
        else:
            amiss.append(one)
    amiss.sort(key=lambda one: (not one.fresh, not one.literal.startswith("not ")))
    return {
        "obs": obs,
        "amiss": amiss,
        "good": list(good.items()),
        "good_count": sum(map(len, good.values())),
    }


def _courses(state: Robot, shown: Sequence[ObservedLiteral]) -> dict[str, Markup]:
    """Return, for what is shown with a number, how that went of late, as a small plot."""
    found: dict[str, Markup] = {}
    for one in shown:
        if one.reading is not None and not isinstance(one.reading.value, str):
            atom = parse_atom(one.literal.removeprefix("not "))
            course = state.measured.course(atom, one.source)
            found[one.literal] = Markup(sparkline(str(atom), course, one.reading.unit))  # it escapes names
    return found


async def _past(parts: Parts, state: Robot, until_ms: int | None, span_s: int | None) -> dict[str, Any]:
    """Return the timeline of a span of time, and the addresses of those before and after it."""
    robot = state.id
    now_ms = time.time_ns() // 1_000_000
    repairs = await parts.repairs.repairs(robot, before=None, limit=REPAIRS)
    if span_s is None:  # the least that shows all of the newest repair, if that was within the hour
        ago_s = (now_ms - repairs[0]["created_ns"] // 1_000_000) / 1000 if repairs else USUAL_S
        span_s = next((span for span in SPANS_S if ago_s <= span <= 3600), USUAL_S)
    end_ms = now_ms if until_ms is None else min(until_ms, now_ms)
    start_ms = max(0, end_ms - span_s * 1000)
    start_ns, end_ns = start_ms * 1_000_000, end_ms * 1_000_000

    def look(view: View) -> tuple[tuple[StoredDiagnosis, ...], bool]:
        return diagnoses.between(view, robot, start_ns, end_ns, PAST)

    found, complete = await parts.store.read(look)
    unknown = end_ms == now_ms and health_of(state)[0] is HealthState.UNKNOWN
    drawn = past.timeline(robot, start_ns, end_ns, found, repairs, unknown=unknown)
    figures: dict[figure.Width, Markup | None] = dict.fromkeys((figure.WIDE, figure.NARROW))
    if drawn.rows or drawn.actions:
        for width in figures:
            # The figure escapes what it shows.
            figures[width] = Markup(await asyncio.to_thread(figure.svg, drawn, width))
    return {
        "past": figures[figure.WIDE],
        "past_narrow": figures[figure.NARROW],
        "past_complete": complete,
        "span": span_s,
        "start_ms": start_ms,
        "end_ms": end_ms,
        "later_ms": None if end_ms >= now_ms else min(now_ms, end_ms + span_s * 1000),
    }


@router.post("/ui/robots/{robot}/observations")
async def observe(request: Request, robot: RobotPath, parts: PartsDep, principal: PrincipalDep) -> Response:
    """Take in what a person has just seen."""
    form = await read_form(request)
    sentence = form.get("observation", "").strip()
    if not sentence:
        raise Problem(422, "say what you saw, as in: not ok(scan)")
    now_ns = CLOCK.now_ns()
    batch = Batch([sentence], time_ns=now_ns, since=[now_ns])
    await parts.robots.observe(robot, batch, by=reporter_of(principal))
    return back(f"/ui/robots/{robot}")


@router.post("/ui/robots/{robot}/repairs")
async def ask_for_repair(
    request: Request, robot: RobotPath, parts: PartsDep, principal: PrincipalDep
) -> Response:
    """Ask for a repair of the best choice; under the policy `approve` its plan waits for a yes."""
    form = await read_form(request)
    await parts.repairs.create(robot, bad=None, by=principal.name, reason=reason_of(form))
    return back(f"/ui/robots/{robot}")


@router.post("/ui/robots/{robot}/release")
async def release(request: Request, robot: RobotPath, parts: PartsDep, principal: PrincipalDep) -> Response:
    """Let a component in quarantine be tried again."""
    form = await read_form(request)
    component, reason = form.get("component", ""), reason_of(form)
    await parts.repairs.release(robot, component, by=principal.name, reason=reason)
    return back(f"/ui/robots/{robot}")


@router.post("/ui/robots/{robot}/board/{channel}")
async def switch_channel(
    request: Request,
    robot: RobotPath,
    channel: Annotated[int, Path(ge=0, le=255)],
    parts: PartsDep,
    principal: PrincipalDep,
) -> Response:
    """Switch a channel, as PUT /api/v1/robots/{robot}/board/channels/{channel} does."""
    form = await read_form(request)
    if form.get("on") not in {"yes", "no"}:
        raise Problem(422, "say whether the channel is to be on: yes or no")
    switch = parts.repairs.switch
    board = await parts.robots.board(robot)
    state = await parts.robots.memory.robot(robot)
    await board.switch(
        channel,
        form["on"] == "yes",
        stop=lambda: switch.stop,
        interlocked=state.interlocked,
        by=principal.name,
        reason=reason_of(form),
    )
    return back(f"/ui/robots/{robot}")


@router.get("/ui/repairs/{repair}")
async def repair_page(
    request: Request, repair: RepairPath, parts: PartsDep, principal: PrincipalDep
) -> Response:
    """Show what a repair found, planned and did, in words."""
    found = await parts.repairs.repair(repair)
    wanted = wanted_parts(request, ("stop", "record", "moments"))
    kept = await parts.store.read(_moments_of, found) if "moments" in wanted else {}
    return await page(
        request,
        "repair.html",
        **shell(request, parts, principal, wanted),
        **kept,
        repair=found,
        robot=found["robot"],
    )


def _moments_of(view: View, repair: Mapping[str, Any]) -> dict[str, Any]:
    """Return the moments of what a repair is about: the first of them was before it."""
    first_ns = repair["created_ns"] - BEFORE_NS
    last_ns = repair["finished_ns"] or time.time_ns()
    return _told_moments(view, moments.between(view, repair["robot"], first_ns, last_ns, MOMENTS))


@router.get("/ui/moments/{moment}")
async def moment_page(
    request: Request, moment: MomentPath, parts: PartsDep, principal: PrincipalDep
) -> Response:
    """Show what an agent kept of the time in which something turned bad."""
    found = await parts.store.read(moment_out, moment)
    wanted = wanted_parts(request, ("stop", "moment"))
    return await page(request, "moment.html", **shell(request, parts, principal, wanted), moment=found)


@router.post("/ui/repairs/{repair}")
async def decide(request: Request, repair: RepairPath, parts: PartsDep, principal: PrincipalDep) -> Response:
    """Approve a repair that awaits it, or cancel one that has not ended."""
    form = await read_form(request)
    decision, reason = form.get("decision"), reason_of(form)
    if decision not in {"approve", "cancel"}:
        raise Problem(422, "the decision is approve or cancel")
    ask = parts.repairs.approve if decision == "approve" else parts.repairs.cancel
    found = await ask(repair, by=principal.name, reason=reason)
    return back(f"/ui/robots/{found['robot']}")
