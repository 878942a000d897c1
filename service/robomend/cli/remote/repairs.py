"""`robomend repairs`, `approve` and `cancel`: what was found, planned and done, and a person's yes or no."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import click

from robomend.cli.remote.connection import DECLINED, asking, format_option, service_options
from robomend.cli.remote.names import RepairName, RobotName
from robomend.cli.tables import at, printable, show_paragraph, show_table
from robomend.planning.plan import step_title
from robomend.repairs.headline import short
from robomend.repairs.states import RepairState


@click.command("repairs")
@click.argument("repair", type=RepairName(), required=False)
@click.option("--robot", type=RobotName(), metavar="ID", help="Only those of this robot.")
@click.option("--open", "open_only", is_flag=True, help="Only those that have not ended.")
@click.option("--limit", type=click.IntRange(1, 1000), default=20, show_default=True, help="The newest.")
@service_options("viewer")
@format_option()
def repairs(
    repair: str | None,
    robot: str | None,
    open_only: bool,
    limit: int,
    url: str,
    key: str | None,
    format_: str,
) -> None:
    """List repairs, newest first; or tell one REPAIR in words: what was seen, why this, what was done.

    Times are UTC.
    """
    if repair is not None and (robot or open_only):
        raise click.UsageError("name a REPAIR, or list those of --robot, or --open: not both")
    with asking(url, key, robot=robot, repair=repair) as client:
        if repair is not None:
            _one(client.repair(repair), format_)
            return
        if robot is None:
            found = client.all_repairs(limit=limit, open_only=open_only)
        else:
            found = client.repairs(robot, limit=limit)
    items = [one for one in found["items"] if not open_only or one["finished_ns"] is None]
    if format_ == "json":
        click.echo(json.dumps({"items": items, "next": found["next"]}, ensure_ascii=False))
        return
    if not items:
        click.echo("no repair is open" if open_only else "no repairs yet")
        return
    show_table(("repair", "robot", "began", "bad", "state"), map(_row, items))
    if found["next"] is not None:
        click.echo(f"\nthere are older ones: these are the newest {limit}")


def _row(one: Mapping[str, Any]) -> tuple[str, ...]:
    bad = ", ".join((one["diagnosis"] or {}).get("bad", ()))
    state = one["state"] + (f": {short(one['reason'])}" if one["reason"] else "")
    return one["id"], one["robot"], at(one["created_ns"]), bad, state


def _one(repair: Mapping[str, Any], format_: str) -> None:
    if format_ == "json":
        click.echo(json.dumps(repair, ensure_ascii=False))
        return
    for line in repair["account"]:
        show_paragraph(line)
    if repair["state"] == RepairState.AWAITING_APPROVAL:
        click.echo(f"yes: robomend approve {repair['id']}; no: robomend cancel {repair['id']}")


@click.command("repair")
@click.argument("robot", type=RobotName())
@click.option("--bad", multiple=True, metavar="COMPONENT", help="What is to be repaired; by default: chosen.")
@click.option("--reason", default="", help="Why; it goes to the audit log.")
@service_options("operator")
@format_option()
def repair(robot: str, bad: tuple[str, ...], reason: str, url: str, key: str | None, format_: str) -> int:
    """Begin a repair of ROBOT now; under the policy approve its plan waits for a yes. 1 where one is open."""
    from robomend_client.rest.errors import StateConflict

    with asking(url, key, robot=robot) as client:
        try:
            begun = client.start_repair(robot, bad=list(bad) or None, reason=reason)
        except StateConflict as error:
            click.echo(f"not begun: {printable(error.detail)}", err=True)
            return DECLINED
    if format_ == "json":
        click.echo(json.dumps(begun, ensure_ascii=False))
    else:
        click.echo(f"begun: repair {begun['id']} of {robot}")
        click.echo(f"follow it: robomend watch {robot}")
    return 0


@click.command("approve")
@click.argument("repair", type=RepairName(RepairState.AWAITING_APPROVAL))
@click.option("--reason", default="", help="Why; it goes to the audit log.")
@service_options("operator")
@format_option()
def approve(repair: str, reason: str, url: str, key: str | None, format_: str) -> int:
    """Say yes to the plan of REPAIR, which waits for it. 1 where that comes too late."""
    return _decide("approve", repair, reason, url, key, format_)


@click.command("cancel")
@click.argument("repair", type=RepairName(open_only=True))
@click.option("--reason", default="", help="Why; it goes to the audit log.")
@service_options("operator")
@format_option()
def cancel(repair: str, reason: str, url: str, key: str | None, format_: str) -> int:
    """End REPAIR before its next action; what runs is cut off. 1 where it has ended already."""
    return _decide("cancel", repair, reason, url, key, format_)


def _decide(decision: str, repair: str, reason: str, url: str, key: str | None, format_: str) -> int:
    from robomend_client.rest.errors import StateConflict

    with asking(url, key, repair=repair) as client:
        try:
            decided = (client.approve if decision == "approve" else client.cancel)(repair, reason)
        except StateConflict as error:
            click.echo(f"too late: {printable(error.detail)}", err=True)
            return DECLINED
    if format_ == "json":
        click.echo(json.dumps(decided, ensure_ascii=False))
        return 0
    said = "approved" if decision == "approve" else "cancelled"
    click.echo(f"{said}: repair {repair} of {decided['robot']}")
    if decision == "approve":
        for step in decided["plan"]:
            click.echo(f"  {printable(step_title(step))}")
        click.echo(f"follow it: robomend watch {decided['robot']}")
    return 0
