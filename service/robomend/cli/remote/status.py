"""`robomend status`: every robot of a running service at a glance, or one in detail."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import click

from robomend.cli.remote.connection import asking, format_option, service_options
from robomend.cli.remote.names import RobotName
from robomend.cli.tables import at, show_paragraph, show_table
from robomend.planning.plan import in_prose, step_title
from robomend.repairs.headline import observed, short
from robomend.repairs.states import RepairState
from robomend_client.counts import counted

if TYPE_CHECKING:
    from robomend_client.rest import Client

ILL = 1
SHOWN = 5
"""Diagnoses of one robot; of more the number is told."""

MEASURED = 10
"""Readings of what does not hold; of more the number is told."""

STATES = ("healthy", "unhealthy", "degraded", "partly-unknown", "unknown", "waiting")


@click.command("status")
@click.argument("robot", type=RobotName(), required=False)
@click.option("--search", default="", metavar="WORDS", help="Only robots with these words in their line.")
@click.option("--state", type=click.Choice(STATES), help="Only robots in this state; waiting: for a person.")
@click.option("--page", type=click.IntRange(min=1), default=1, show_default=True)
@click.option("--rows", type=click.IntRange(1, 1000), default=100, show_default=True, help="Of a page.")
@click.option("--fail-on-fault", is_flag=True, help="Exit with 1 unless all of them are healthy.")
@service_options("viewer")
@format_option()
def command(
    robot: str | None,
    search: str,
    state: str | None,
    page: int,
    rows: int,
    fail_on_fault: bool,
    url: str,
    key: str | None,
    format_: str,
) -> int:
    """Say how every robot is, what is wrong with it and what it waits for; or tell more of one ROBOT.

    Whoever waits for a person comes first. Times are UTC.
    """
    with asking(url, key, robot=robot) as client:
        if robot is not None:
            known = _one(client, robot)
            healthy = known["robot"]["state"] == "healthy"
        else:
            known = dict(client.status(search, state=state or "", page=page, rows=rows))
            known["stop"] = client.stopped()
            healthy = known["counts"]["healthy"] == known["total"]
    if format_ == "json":
        click.echo(json.dumps(known, ensure_ascii=False))
    elif robot is not None:
        for line in _told(known):
            show_paragraph(line)
    else:
        _show(known)
    return ILL if fail_on_fault and not healthy else 0


def _show(found: Mapping[str, Any]) -> None:
    _stop(found["stop"])
    if not found["total"]:
        click.echo("no robots yet: `robomend robot put ID FILE` configures one")
        return
    show_table(
        ("robot", "state", "what is wrong, and what is next"),
        ((one["robot"], one["state"] or "not read yet", one["headline"]) for one in found["robots"]),
    )
    counts = ", ".join(
        f"{found['counts'][state]} {state}" + (" for a person" if state == "waiting" else "")
        for state in STATES
        if found["counts"].get(state)
    )
    pages = f"; page {found['page']} of {found['pages']}" if found["pages"] > 1 else ""
    shown = "" if found["found"] == found["total"] else f"; {found['found']} shown"
    unread = "" if found["complete"] else "; some are not read yet, ask again"
    total = found["total"]
    click.echo(f"\n{counted(total, 'robot')}: {counts or 'not read yet'}{shown}{pages}{unread}")


def _stop(stop: Mapping[str, Any]) -> None:
    if stop["active"]:
        show_paragraph(stopped(stop))
        click.echo()


def stopped(stop: Mapping[str, Any]) -> str:
    """Return the global stop in words."""
    reason = f": {stop['reason']}" if stop["reason"] else ""
    return f"STOPPED by {stop['by']} at {at(stop['since_ns'])} UTC{reason}; no robot acts"


def _one(client: Client, robot: str) -> dict[str, Any]:
    """Return what the service knows of one robot."""
    value = client.robot(robot).value
    diagnosis = client.diagnosis(robot)
    repairs = client.repairs(robot, limit=1)["items"]
    seen = client.observations(robot)["observations"]
    return {
        "robot": value,
        "diagnosis": diagnosis,
        "measured": [one for one in seen if one["fresh"] and one.get("reading") and _negative(one)],
        "repair": repairs[0] if repairs else None,
        "functions": client.functions(robot),
        "stop": client.stopped(),
    }


def _negative(one: Mapping[str, Any]) -> bool:
    return str(one["literal"]).startswith("not ")


def _told(known: Mapping[str, Any]) -> Iterator[str]:
    """Yield one robot, line by line."""
    robot, diagnosis, repair, stop = (known[name] for name in ("robot", "diagnosis", "repair", "stop"))
    config = robot["config"]
    yield f"{robot['id']}: {robot['state']}; model {config['model']}, policy {config['policy']}"
    yield robot["headline"]
    if stop["active"]:
        yield stopped(stop)
    if robot["unknown"]:
        yield f"not known: {', '.join(robot['unknown'])}"
    for one in known["measured"][:MEASURED]:
        yield f"seen: {observed(one)}"
    if len(known["measured"]) > MEASURED:
        yield f"and {len(known['measured']) - MEASURED} more"
    if diagnosis["fault"] is not None:
        yield f"no diagnosis: {diagnosis['fault']['detail']}"
    elif diagnosis["result"] is not None:
        found = [one for one in diagnosis["result"]["diagnoses"] if one["bad"]]
        if found:
            which = "this" if len(found) == 1 else "any of these"
            yield f"diagnosed at {at(diagnosis['time_ns'])} UTC; {which} explains what was seen:"
        for one in found[:SHOWN]:
            weight = "" if one["probability"] is None else f"  (probability {one['probability']:.2g})"
            yield f"  {', '.join(one['bad'])}{weight}"
        if len(found) > SHOWN:
            yield f"  and {len(found) - SHOWN} more"
    for one in known["functions"]:
        held = f"; {one['held']}" if one["held"] else ""
        yield f"{one['function']}: {one['active'] or 'not known'} (best now: {one['goal'] or 'none'}){held}"
    if repair is not None:
        ended = f", ended {at(repair['finished_ns'])}" if repair["finished_ns"] else ""
        told = short(repair["reason"]) in robot["headline"]
        reason = f": {in_prose(repair['reason'])}" if repair["reason"] and not told else ""
        yield f"repair {repair['id']}: {repair['state']}{ended}{reason}"
        if repair["state"] == RepairState.AWAITING_APPROVAL:
            for step in repair["plan"]:
                yield f"  {step_title(step)}"
            yield f"  yes: robomend approve {repair['id']}; no: robomend cancel {repair['id']}"
    for finding in robot["findings"]:
        yield f"note: {finding}"
