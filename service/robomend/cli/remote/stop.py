"""`robomend stop`: the global stop of a running service."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import click

from robomend.cli.remote.connection import asking, format_option, service_options
from robomend.cli.remote.status import stopped
from robomend.cli.tables import show_paragraph

if TYPE_CHECKING:
    from robomend_client.rest.types import Stop


@click.command("stop")
@click.argument("what", type=click.Choice(("set", "lift", "show")), default="set")
@click.option("--reason", default="", help="Why; it goes to the audit log. Lifting needs one.")
@service_options("operator (show: viewer)")
@format_option()
def command(what: str, reason: str, url: str, key: str | None, format_: str) -> None:
    """Stop all robots (set, at once, without a question), lift the stop, or show whether there is one.

    While it is set no robot acts, whoever asks for it; what runs is cut off. The service itself goes on.
    """
    if what == "lift" and not reason.strip():
        raise click.UsageError("say why robots may act again: robomend stop lift --reason …")
    with asking(url, key) as client:
        if what == "set":
            stop = client.stop(reason)
        else:
            stop = client.resume(reason) if what == "lift" else client.stopped()
    if format_ == "json":
        click.echo(json.dumps(stop, ensure_ascii=False))
    else:
        show_paragraph(_told(stop))
        if what == "set":
            click.echo("robots may act again after: robomend stop lift --reason …", err=True)


def _told(stop: Stop) -> str:
    words = stopped(stop) if stop["active"] else "no stop is set: robots may act, as their policies say"
    return words if stop["written"] else f"{words}; {stop['detail'] or 'not on disk yet'}"
