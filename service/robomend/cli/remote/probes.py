"""`robomend probes` and `robomend observe`: what to look at next, and saying what was seen."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from robomend.cli.remote.connection import asking, format_option, service_options
from robomend.cli.remote.names import RobotName
from robomend.cli.remote.watch import NO_FAULT
from robomend.cli.tables import diagnoses, show_paragraph, show_table

if TYPE_CHECKING:
    from robomend_client.rest import Client
    from robomend_client.rest.types import Accepted

DIAGNOSED_S = 30.0
"""For the diagnosis of what was just observed."""


@click.command("probes")
@click.argument("robot", type=RobotName())
@click.option(
    "--answer",
    multiple=True,
    metavar="SENTENCE",
    help='What you saw, e.g. "on(hokuyo)" or "not on(hokuyo)"; repeatable.',
)
@click.option("--limit", type=click.IntRange(1, 1000), default=5, show_default=True)
@service_options("viewer (to answer: operator)")
@format_option()
def probes(robot: str, answer: tuple[str, ...], limit: int, url: str, key: str | None, format_: str) -> None:
    """Say what to look at next on ROBOT: what would tell its diagnoses apart best.

    With --answer, report what you saw, and say what to look at after that.
    """
    with asking(url, key, robot=robot) as client:
        if answer:
            accepted = client.observe(robot, answer)
            _diagnosed(client, robot, accepted["revision"])
        found = client.probes(robot, limit)
        current = client.diagnosis(robot)
    if format_ == "json":
        click.echo(json.dumps(found, ensure_ascii=False))
        return
    show_paragraph(_bad(current))
    if not found["probes"]:
        show_paragraph(f"nothing to look at: {found['reason'] or 'no probe tells more'}")
        return
    result = current["result"]
    bad = [] if result is None else [one["bad"] for one in result["diagnoses"]]
    click.echo()
    show_table(
        ("look at", "bad, if true", "bad, if false", "bits", "takes"),
        (
            (
                probe["atom"],
                diagnoses([one for one in bad if one not in probe["if_false"]]),
                diagnoses([one for one in bad if one not in probe["if_true"]]),
                f"{probe['gain_bits']:.2f}",
                f"{probe['cost_s']:g} s",
            )
            for probe in found["probes"]
        ),
    )
    first = found["probes"][0]["atom"]
    click.echo()
    show_paragraph(f'then: robomend probes {robot} --answer "{first}", or --answer "not {first}"')


@click.command("observe")
@click.argument("robot", type=RobotName())
@click.argument("sentences", nargs=-1, required=True, metavar="SENTENCE...")
@click.option("--source", help="Who says so; by default the name of the key.")
@click.option("--lifetime", type=click.FloatRange(min=0, min_open=True), help="Seconds; unknown after them.")
@click.option(
    "--reading",
    "readings",
    multiple=True,
    metavar="TEXT",
    help='What was measured, e.g. "19.1 V, at least 22"; once for each SENTENCE, in their order.',
)
@service_options("operator, or the robot's own")
@format_option()
def observe(
    robot: str,
    sentences: tuple[str, ...],
    source: str | None,
    lifetime: float | None,
    readings: tuple[str, ...],
    url: str,
    key: str | None,
    format_: str,
) -> None:
    """Report to the service what was observed on ROBOT, and say what it makes of it.

    A SENTENCE reads ok(scan), "not ok(scan)", "not on(hokuyo)", "running(mapper)": see docs/models.md.
    """
    from robomend_client.readings import Reading

    if readings and len(readings) != len(sentences):
        raise click.UsageError(
            f"{len(readings)} readings for {len(sentences)} sentences: give --reading once for each"
        )
    measured = [Reading(text) for text in readings] or None
    with asking(url, key, robot=robot) as client:
        accepted = client.observe(robot, sentences, source=source, lifetime_s=lifetime, readings=measured)
        current = _diagnosed(client, robot, accepted["revision"])
    if format_ == "json":
        click.echo(json.dumps({**accepted, "diagnosis": current}, ensure_ascii=False))
        return
    show_paragraph(_taken(accepted))
    show_paragraph(_bad(current))


def _taken(accepted: Accepted) -> str:
    changed = ", ".join(accepted["changed"])
    return f"taken in as revision {accepted['revision']}: {changed or 'nothing new'}"


def _diagnosed(client: Client, robot: str, revision: int) -> Mapping[str, Any]:
    """Return the diagnosis of this revision or a newer one; the last there is where none comes in time."""
    return client.diagnosis(robot, wait_s=DIAGNOSED_S, after=revision - 1)


def _bad(current: Mapping[str, Any]) -> str:
    """Return a diagnosis as one sentence."""
    if current["fault"] is not None:
        return f"no diagnosis: {current['fault']['detail']}"
    if current["result"] is None:
        return "not diagnosed yet"
    found = [one["bad"] for one in current["result"]["diagnoses"]]
    if any(not bad for bad in found):
        return NO_FAULT
    return f"bad: {diagnoses(found)}" if found else "no diagnosis within the limits"
