"""`robomend drill`: faults planted on purpose on a robot, by its service; what became of them, scored."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from robomend.cli.files import ExistingFile
from robomend.cli.remote.connection import format_option, service_options
from robomend.cli.remote.names import RobotName
from robomend.errors import InputError

if TYPE_CHECKING:
    from robomend.planning.drill import PlantableFault

REFUSED = 1

BY_HAND = "a person"


@click.command("drill")
@click.argument("robot", type=RobotName())
@click.option("--plan", is_flag=True, help="Only say what could be planted, and what it would show.")
@click.option("--fault", "wanted", multiple=True, metavar="KIND:NAME", help="Plant this; repeatable.")
@click.option("--all", "all_", is_flag=True, help="Plant every fault that agents and the board can plant.")
@click.option("--by-hand", is_flag=True, help="With --all: also those that a person plants.")
@click.option("--yes", is_flag=True, help="Do not ask before the first fault.")
@click.option("--bound-s", type=click.FloatRange(1, 3000), default=60.0, show_default=True, help="Of each.")
@click.option(
    "--detect-s",
    type=click.FloatRange(1, 3000),
    default=15.0,
    show_default=True,
    help="One that is not seen by then is undone.",
)
@click.option("--reason", default="", help="Goes to the audit log.")
@click.option("--against", type=ExistingFile(), metavar="LAST.json", help="Compare with an earlier report.")
@service_options("operator; viewer for --plan")
@format_option()
def command(
    robot: str,
    plan: bool,
    wanted: tuple[str, ...],
    all_: bool,
    by_hand: bool,
    yes: bool,
    bound_s: float,
    detect_s: float,
    reason: str,
    against: Path | None,
    url: str,
    key: str | None,
    format_: str,
) -> int:
    """Plant faults on ROBOT, one at a time, watch what is diagnosed and repaired, and undo them.

    The service plants and undoes; ending this command leaves nothing planted. It asks before the first fault,
    unless --yes is said. --plan plants nothing.

    1 where a fault came out worse than promised, or than --against; where one was not watched to its end or
    not undone; and, with --plan, where a drill would be refused now.
    """
    if sum((plan, bool(wanted), all_)) != 1:
        raise click.UsageError("say one of --plan, --fault KIND:NAME and --all")
    last = None if against is None else _read(against)
    from robomend.cli import drill_plan

    found = drill_plan.asked(robot, url, key)
    if plan:
        if format_ == "json":
            click.echo(json.dumps(drill_plan.plan_json(robot, found), ensure_ascii=False))
        else:
            drill_plan.show_plan(robot, found)
        return REFUSED if found.obstacles else 0
    chosen = _chosen(found.faults, wanted, by_hand)
    if not yes:
        _ask(robot, chosen)
    from robomend.cli.drill_run import Bounds, carried_out, show

    rows = carried_out(robot, chosen, Bounds(bound_s, detect_s, reason), found.observers, url, key)
    return show(robot, rows, last, complete=found.complete, as_json=format_ == "json")


def _read(against: Path) -> dict[str, Any]:
    """Return an earlier report, before anything is planted."""
    from robomend.drills.score import compared, report

    try:
        last: dict[str, Any] = json.loads(against.read_text(encoding="utf-8"))
        compared(report("", [], complete=True), last)
    except (OSError, ValueError, AttributeError, KeyError, TypeError) as error:
        raise InputError(f"{against}: {error}") from error
    return last


def _chosen(faults: Sequence[PlantableFault], wanted: Sequence[str], by_hand: bool) -> list[PlantableFault]:
    """Return what is to be planted; InputError for what never is."""
    from robomend.planning.faults import BY
    from robomend_client.near import nearest

    if not wanted:
        return [one for one in faults if one.refused is None and (by_hand or BY[one.kind] != BY_HAND)]
    named = {one.name: one for one in faults}
    for name in wanted:
        if name not in named:
            near = nearest(name, list(named))
            raise InputError(f"there is no fault {name}" + (f"; did you mean {near}?" if near else ""))
        if (why := named[name].refused) is not None:
            raise InputError(f"{name} is never planted: {why}")
    return [named[name] for name in wanted]


def _ask(robot: str, chosen: Sequence[PlantableFault]) -> None:
    """Let a person say yes."""
    click.echo(f"on {robot}, one after the other:", err=True)
    for fault in chosen:
        click.echo(f"  {fault.act}; undone by: {fault.undo}", err=True)
    click.confirm(f"plant {len(chosen)} fault{'s' if len(chosen) != 1 else ''}?", abort=True, err=True)
