"""Drills, one after the other, through the service: asked for, waited for, scored, shown."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from robomend.cli.remote.connection import asking
from robomend.cli.tables import diagnoses
from robomend.drills.score import compared, name_of, passed, report, scored
from robomend.repairs.states import RepairState
from robomend_client.counts import counted
from robomend_client.rest.errors import ApiError, ClientError, StateConflict

if TYPE_CHECKING:
    from robomend.planning.drill import PlantableFault
    from robomend_client.rest import Client

WELL_S = 60.0
"""For the robot to be as it must be before the next fault."""

LOOK_S = 0.2

BEYOND_S = 600.0
"""A drill that has not ended so long after its bound is left to the service, which goes on undoing it."""

AWAY_S = 60.0
"""For a service that does not answer to be back."""


@dataclass(frozen=True)
class Bounds:
    """Of each drill."""

    bound_s: float
    detect_s: float
    reason: str


def carried_out(
    robot: str,
    faults: Sequence[PlantableFault],
    bounds: Bounds,
    observers: Mapping[str, str],
    url: str,
    key: str | None,
) -> list[dict[str, Any]]:
    """Carry out drills; return the rows of the report. `observers`: which agent reports what."""
    from robomend.cli.drill_plan import fault_json

    rows = []
    with asking(url, key, robot=robot) as client:
        for number, fault in enumerate(faults, 1):
            planned = fault_json(fault, observers)
            click.echo(f"{number}/{len(faults)} {fault.act} …", err=True)
            try:
                drill = _begun(client, robot, fault, bounds)
            except ApiError as error:  # refused: the others may not be
                rows.append(scored(planned, None, error.detail))
                click.echo(f"    not planted: {error.detail}", err=True)
                continue
            try:
                ended = _ended(client, drill["id"], bounds.bound_s)
            except KeyboardInterrupt:
                _cancel(client, drill["id"])
                raise
            rows.append(scored(planned, ended))
            click.echo(f"    {_in_words(rows[-1])}", err=True)
    return rows


def _begun(client: Client, robot: str, fault: PlantableFault, bounds: Bounds) -> dict[str, Any]:
    """Begin a drill as soon as the robot is as it must be; StateConflict if it is not in time."""
    deadline = time.monotonic() + WELL_S
    while True:
        try:
            return client.start_drill(
                robot,
                str(fault.kind),
                fault.component,
                topic=fault.topic,
                bound_s=bounds.bound_s,
                detect_s=bounds.detect_s,
                reason=bounds.reason,
            )
        except StateConflict:
            if time.monotonic() >= deadline:
                raise
        time.sleep(LOOK_S)


def _ended(client: Client, drill: str, bound_s: float) -> dict[str, Any]:
    """Wait for the end of a drill, and let a person do what it waits for."""
    deadline = time.monotonic() + bound_s + BEYOND_S
    heard = time.monotonic()
    while True:
        try:
            found = client.drill(drill)
            heard = time.monotonic()
        except ClientError:
            if time.monotonic() - heard > AWAY_S:
                raise
            time.sleep(LOOK_S)
            continue
        if found["finished_ns"] is not None or time.monotonic() >= deadline:
            return found
        if (what := found["waiting_for"]) is not None:
            click.echo(f"    now: {what}; then press Enter", err=True)
            sys.stdin.readline()
            try:
                client.decide_drill(drill, "done")
            except StateConflict as error:
                click.echo(f"    {error.detail}", err=True)
        time.sleep(LOOK_S)


def _cancel(client: Client, drill: str) -> None:
    """Somebody ends the command: the drill ends, too."""
    try:
        client.decide_drill(drill, "cancel", "the command was ended")
        click.echo(f"    {drill} is cancelled: the service undoes it", err=True)
    except StateConflict:
        click.echo(f"    {drill} is being undone already", err=True)
    except ClientError as error:
        click.echo(f"    {drill} could not be cancelled ({error}): the service undoes it in time", err=True)


def show(
    robot: str,
    rows: Sequence[Mapping[str, Any]],
    last: Mapping[str, Any] | None,
    *,
    complete: bool,
    as_json: bool,
) -> int:
    """Print the report; return 1 where something is worse than it should be."""
    found = report(robot, rows, complete)
    against = None if last is None else compared(found, last)
    if as_json:
        told = found if against is None else {**found, "against": against}
        click.echo(json.dumps(told, ensure_ascii=False))
    else:
        _table(found, against)
    return 0 if passed(found) and not (against and against["worse"]) else 1


def _table(found: Mapping[str, Any], against: Mapping[str, list[str]] | None) -> None:
    for row in found["faults"]:
        click.echo(f"{name_of(row)}: {_in_words(row)}")
        for what in row["look_at"]:
            click.echo(f"    look at {what}")
    sums = found["totals"]
    told = f"{sums['told']} told apart ({sums['promised_and_told']} of {sums['promised_told']} promised)"
    faults, acts = counted(sums["faults"], "fault"), counted(sums["acts"], "act")
    click.echo(
        f"{sums['watched']} of {faults} watched: {sums['detected']} detected, {told}, "
        f"{sums['repaired']} repaired, {sums['needless']} of {acts} needless; "
        f"{sums['worse']} worse than promised, {sums['not_undone']} not undone"
    )
    if sums["detected_s"] is not None:
        repaired = "" if sums["repaired_s"] is None else f", repaired after {sums['repaired_s']:g} s"
        click.echo(f"medians: detected after {sums['detected_s']:g} s{repaired}")
    for what, changes in (against or {}).items():
        for change in changes:
            click.echo(f"{what.replace('_', ' ')}: {change}")


def _in_words(row: Mapping[str, Any]) -> str:
    """Return what a drill came to in one line."""
    if row["outcome"] is None:
        left = "" if row["undone"] else "; NOT UNDONE yet, the service goes on"
        return f"not watched to its end: {row['why_not'] or row['state']}{left}"
    blamed = diagnoses(row["diagnoses"])
    words = {
        "told": "told",
        "among": f"one of {blamed}",
        "missed": f"another is blamed: {blamed}",
        "unseen": "not seen",
    }[row["outcome"]]
    seen = "" if row["detected_s"] is None else f" after {row['detected_s']:g} s"
    ended = "not repaired" if not row["repaired"] else f"repaired after {row['repaired_s']:g} s"
    if row["repair_state"] not in {None, RepairState.REPAIRED}:
        ended += f" ({row['repair_state']}: {row['repair_reason']})"
    needless = f", needless: {', '.join(row['needless'])}" if row["needless"] else ""
    promise = "" if row["kept"] else f"; promised was: {row['promise']}"
    return f"{words}{seen}, {ended}{needless}{promise}"
