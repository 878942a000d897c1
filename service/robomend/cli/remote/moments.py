"""`robomend moments`: what agents kept of the time around a fault."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import IO, Any

import click

from robomend.cli.remote.connection import asking, format_option, service_options
from robomend.cli.remote.names import RobotName
from robomend.cli.tables import at, printable, show_paragraph, show_table
from robomend_client.counts import first_few


@click.command("moments")
@click.argument("robot", type=RobotName())
@click.argument("moment", required=False)
@click.option("--mcap", type=click.File("wb", lazy=True), help="Write the recording of MOMENT to this file.")
@click.option("--limit", type=click.IntRange(1, 1000), default=20, show_default=True, help="The newest.")
@service_options("viewer")
@format_option()
def command(
    robot: str,
    moment: str | None,
    mcap: IO[bytes] | None,
    limit: int,
    url: str,
    key: str | None,
    format_: str,
) -> None:
    """List what the agents of ROBOT kept when something turned bad; or show one MOMENT (`newest` will do).

    Times are UTC.
    """
    if mcap is not None and moment is None:
        raise click.UsageError("--mcap writes the recording of one MOMENT: name it, or say `newest`")
    with asking(url, key, robot=robot) as client:
        if moment is None:
            _all(client.moments(robot, limit=limit), limit, format_)
            return
        if moment == "newest":
            found = client.moments(robot, limit=1)["items"]
            if not found:
                raise click.UsageError(f"{robot} has no moments yet")
            moment = str(found[0]["id"])
        if mcap is not None:
            client.moment_recording(moment, mcap)
            click.echo(f"{mcap.name}: {mcap.tell()} bytes", err=True)
        else:
            _one(client.moment(moment), format_)


def _all(found: Mapping[str, Any], limit: int, format_: str) -> None:
    if format_ == "json":
        click.echo(json.dumps(found, ensure_ascii=False))
    elif not found["items"]:
        click.echo("no moments yet")
    else:
        show_table(("moment", "came", "turned bad", "recording"), map(_row, found["items"]))
        if found["next"] is not None:
            click.echo(f"\nthere are older ones: these are the newest {limit}")


def _row(one: Mapping[str, Any]) -> tuple[str, ...]:
    size = one["recording_bytes"]
    return one["id"], at(one["created_ns"]), _said(one), "" if size is None else f"{size / 1e6:.1f} MB"


def _said(one: Mapping[str, Any]) -> str:
    told = [
        each["literal"] + (f" ({each['reading']})" if each["reading"] else "") for each in one["literals"]
    ]
    return first_few(told, 4)


def _one(one: Mapping[str, Any], format_: str) -> None:
    if format_ == "json":
        click.echo(json.dumps(one, ensure_ascii=False))
        return
    show_paragraph(f"{at(one['created_ns'])}: {_said(one)}")
    for process in one["frame"]["processes"]:
        show_paragraph(f"process {process['node']}: {process['about']}")
    for log in one["frame"]["logs"]:
        show_paragraph(f"last lines of {log['node']}:")
        for line in log["lines"]:
            click.echo(f"  {printable(line)}")
    for topic in one["frame"]["topics"]:
        for message in topic["messages"][-1:]:
            show_paragraph(f"{topic['topic']} at {message['at_s']:.2f} s:")
            for line in message["text"].splitlines():
                click.echo(f"  {printable(line)}")
    for note in one["frame"]["notes"]:
        show_paragraph(f"note: {note}")
