"""`robomend batches`: logs that a running service diagnoses, their results, and the end of one that runs."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import click

from robomend.batches.record import OPEN, BatchState
from robomend.cli.files import ExistingFile
from robomend.cli.remote.connection import DECLINED, asking, format_option, service_options
from robomend.cli.remote.names import BatchName
from robomend.cli.tables import at, printable, show_paragraph, show_table
from robomend.errors import InputError
from robomend_client.counts import counted

if TYPE_CHECKING:
    from robomend_client.rest import Client

LOOK_S = 1.0
"""How often --wait looks how far a batch is."""

BACKEND_FAILED = 3


@click.group("batches")
def command() -> None:
    """Have logs diagnosed by a running service, and fetch what they show."""


@command.command("list")
@click.option("--limit", type=click.IntRange(1, 1000), default=20, show_default=True, help="The newest.")
@service_options("viewer")
@format_option()
def list_(limit: int, url: str, key: str | None, format_: str) -> None:
    """List batches, newest first. Times are UTC."""
    with asking(url, key) as client:
        found = client.batches(limit=limit)
    if format_ == "json":
        click.echo(json.dumps({"items": found["items"], "next": found["next"]}, ensure_ascii=False))
        return
    if not found["items"]:
        click.echo("no batches yet")
        return
    show_table(("batch", "began", "model", "logs", "faulty", "state"), map(_row, found["items"]))
    if found["next"] is not None:
        click.echo(f"\nthere are older ones: these are the newest {limit}")


def _row(one: Mapping[str, Any]) -> tuple[str, ...]:
    began, logs = at(one["created_ns"]), f"{one['done']}/{one['logs']}"
    return one["id"], began, one["model"], logs, str(one["faulty"]), one["state"]


@command.command("post", short_help="Hand in LOGS, to be diagnosed by the service.")
@click.argument("logs", nargs=-1, required=True, metavar="LOGS...")
@click.option("--model", "-m", required=True, help="A model that the service holds, or a file with one.")
@click.option("--observers", type=ExistingFile(), help="For recorded messages: an agent's file.")
@click.option("--below", is_flag=True, help="LOGS are files and patterns below the service's batch_folder.")
@click.option("--time", type=click.Choice(("log", "header")), help="Whose times of messages count.")
@click.option("--together", metavar="log|30s", help="One explanation for a log, or for so long of it.")
@click.option("--minimal", type=click.Choice(("cardinality", "subset")))
@click.option("--max-size", type=click.IntRange(min=0), help="No diagnosis larger than this.")
@click.option("--limit", type=click.IntRange(min=0), help="Diagnoses of a state; 0: no limit.")
@click.option("--timeout", "timeout_s", type=float, help="Seconds per state.")
@click.option("--unknown", type=click.Choice(("refuse", "keep")), help="Names that the model lacks.")
@click.option("--reason", help="Why; it goes to the audit log.")
@click.option("--wait", is_flag=True, help="Until the batch has ended; 3 unless it is done then.")
@service_options("operator")
@format_option()
def post(
    logs: tuple[str, ...],
    model: str,
    observers: Path | None,
    below: bool,
    wait: bool,
    url: str,
    key: str | None,
    format_: str,
    **options: Any,
) -> int:
    """Hand in LOGS, files of this computer, and have the service diagnose them.

    What is not said is as `robomend-batch run` has it. Files are sent by their names alone: two of one name
    are refused.
    """
    fields = {**options, **_model(model)}
    if observers is not None:
        fields["observers"] = observers.read_text("utf-8")
    with contextlib.ExitStack() as open_files:
        files = [] if below else [_opened(name, open_files) for name in logs]
        with asking(url, key) as client:
            batch = client.start_batch(logs, **fields) if below else client.upload_batch(files, **fields)
            if wait:
                click.echo(f"batch {batch['id']}", err=True)
                batch = _ended(client, batch["id"])
    _show(batch, format_)
    return BACKEND_FAILED if batch["state"] in (BatchState.FAILED, BatchState.CANCELLED) else 0


def _model(model: str) -> dict[str, str]:
    """Return the field that says which model: its text, if there is a file, else its name."""
    file = Path(model)
    if file.is_file():
        return {"source": file.read_text("utf-8")}
    if file.suffix:
        raise InputError(f"--model {model}: there is no such file, and no model has such a name")
    return {"model": model}


def _opened(name: str, open_files: contextlib.ExitStack) -> tuple[str, IO[bytes]]:
    file = Path(name)
    try:
        return file.name, open_files.enter_context(file.open("rb"))
    except OSError as error:
        raise InputError(f"{name} cannot be read: {error.strerror}") from error


def _ended(client: Client, batch: str) -> dict[str, Any]:
    """Return a batch when it has ended; the service ends each after `batch_hours`."""
    while (found := client.batch(batch))["state"] in OPEN:
        time.sleep(LOOK_S)
    return found


@command.command("get")
@click.argument("batch", type=BatchName())
@service_options("viewer")
@format_option()
def get(batch: str, url: str, key: str | None, format_: str) -> None:
    """Say how far BATCH is, and what became of its logs."""
    with asking(url, key) as client:
        found = client.batch(batch)
    _show(found, format_)


def _show(batch: Mapping[str, Any], format_: str) -> None:
    if format_ == "json":
        click.echo(json.dumps(batch, ensure_ascii=False))
        return
    show_paragraph(
        f"batch {batch['id']}: {batch['state']}, {batch['done']} of {counted(batch['logs'], 'file')} done"
    )
    states = ", ".join(f"{count} {state}" for state, count in batch["log_states"].items())
    if states:
        show_paragraph(f"  logs: {states}; {batch['faulty']} with faults")
    for line in batch["message"].splitlines():
        show_paragraph(f"  {line}")
    if batch["state"] == BatchState.DONE:
        click.echo(f"results: robomend batches result {batch['id']} --format report -o report.html")


@command.command("result")
@click.argument("batch", type=BatchName(BatchState.DONE))
@click.option(
    "--format",
    "format_",
    type=click.Choice(("ndjson", "logs", "parquet", "report")),
    default="ndjson",
    show_default=True,
    help="The intervals (ndjson, parquet), a line for each log, or the report in HTML.",
)
@click.option("--out", "-o", type=click.Path(dir_okay=False, path_type=Path), help="A file; default: stdout.")
@service_options("viewer")
def result(batch: str, format_: str, out: Path | None, url: str, key: str | None) -> int:
    """Fetch what the logs of BATCH show. 1 while it has not ended."""
    from robomend_client.rest.errors import StateConflict

    beside = None if out is None else out.with_name(f"{out.name}.tmp")
    try:
        with asking(url, key) as client, contextlib.ExitStack() as files:
            into = sys.stdout.buffer if beside is None else files.enter_context(beside.open("wb"))
            try:
                client.batch_result(batch, into, format_)
            except StateConflict as error:
                click.echo(f"too early: {printable(error.detail)}", err=True)
                return DECLINED
        if beside is not None and out is not None:
            os.replace(beside, out)
    except OSError as error:
        if isinstance(error, BrokenPipeError):
            raise
        raise InputError(f"{out}: {error.strerror}") from error
    finally:
        if beside is not None:
            beside.unlink(missing_ok=True)
    return 0


@command.command("cancel")
@click.argument("batch", type=BatchName(*OPEN))
@click.option("--reason", default="", help="Why; it goes to the audit log.")
@service_options("operator")
@format_option()
def cancel(batch: str, reason: str, url: str, key: str | None, format_: str) -> int:
    """End BATCH, its processes as well. 1 where it has ended already."""
    from robomend_client.rest.errors import StateConflict

    with asking(url, key) as client:
        try:
            ended = client.cancel_batch(batch, reason)
        except StateConflict as error:
            click.echo(f"too late: {printable(error.detail)}", err=True)
            return DECLINED
    _show(ended, format_)
    return 0
