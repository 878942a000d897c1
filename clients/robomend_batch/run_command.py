"""`robomend-batch run`: logs in, a folder of results out."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from robomend.cli.files import ExistingFile
from robomend.cli.models import MODEL, load, search_options
from robomend_batch.found import find_logs
from robomend_client.counts import counted

if TYPE_CHECKING:
    from robomend_batch.run import Summary
    from robomend_batch.starting import Started

BAD_INPUT, BACKEND_FAILED, FAULT = 2, 3, 1

SHORTEST_S, LONGEST_S = 0.1, 1e7
"""Of a window that is explained together."""


class Span(click.ParamType[float]):
    """`log`, or a duration: in seconds, infinite for `log`."""

    name = "span"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        if isinstance(value, float):
            return value
        if value == "log":
            return math.inf
        found = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)(s|min|h)", str(value).strip())
        seconds = float(found[1]) * {"s": 1, "min": 60, "h": 3600}[found[2]] if found else 0.0
        if not SHORTEST_S <= seconds <= LONGEST_S:
            self.fail(f"{value!r} is neither `log` nor a time such as 30s, 5min or 1h", param, ctx)
        return seconds


@click.command("run")
@click.argument("logs", nargs=-1, required=True, metavar="LOGS...")
@click.option(
    "--model", "-m", type=MODEL, required=True, help="A component model, five-key model or circuit."
)
@click.option(
    "--out", "-o", type=click.Path(file_okay=False, path_type=Path), required=True, help="Folder of results."
)
@click.option(
    "--observers",
    type=ExistingFile(),
    help="For recorded messages: an agent's file, or its `observers:`; the same ones as on the robot.",
)
@click.option(
    "--time",
    type=click.Choice(("log", "header")),
    default="log",
    show_default=True,
    help="Times of messages: when they were recorded, or as their headers say.",
)
@click.option(
    "--together",
    type=Span(),
    metavar="log|30s",
    help="One explanation for a whole log, or for each window of so long (s, min, h).",
)
@click.option("--minimal", type=click.Choice(("cardinality", "subset")), default="subset", show_default=True)
@click.option("--max-size", type=click.IntRange(min=0), help="No diagnosis larger than this.")
@click.option("--limit", type=click.IntRange(min=0), default=100, show_default=True, help="0: no limit.")
@click.option("--timeout", type=float, default=5.0, show_default=True, help="Seconds per state; inf: none.")
@click.option(
    "--log-timeout",
    type=click.FloatRange(min=0, min_open=True),
    metavar="SECONDS",
    help="Of a processor's time, for one log; default: 600, and 5 for each of its MB; inf: none.",
)
@click.option(
    "--unknown",
    type=click.Choice(("refuse", "keep")),
    default="refuse",
    show_default=True,
    help="A log with names that the model does not declare.",
)
@click.option(
    "--workers",
    type=click.IntRange(min=0, max=256),
    help="Processes; default: as many as cores, and no more than logs. 0: none but this one.",
)
@click.option(
    "--scheduler",
    metavar="tcp://HOST:PORT",
    help="An existing Dask cluster in place of processes of this computer; its workers see the same files.",
)
@click.option("--overwrite", is_flag=True, help="OUT holds results of another run: replace them.")
@click.option("--ndjson/--no-ndjson", default=True, show_default=True, help="Write results.ndjson as well.")
@click.option(
    "--parquet/--no-parquet", default=False, show_default=True, help="Write results.parquet as well."
)
@click.option(
    "--code/--no-code",
    default=True,
    show_default=True,
    help="Run observers of FILE.py; else they are refused.",
)
@click.option("--fail-on-fault", is_flag=True, help="Exit with 1 if any log shows a fault.")
@click.option("--quiet", "-q", is_flag=True, help="No progress on stderr.")
def command(logs: tuple[str, ...], model: str, out: Path, **given: Any) -> int:
    """Diagnose LOGS: files, folders or patterns ("logs/**/*.mcap").

    ROS 1 .bag, ROS 2 .mcap and .db3, recordings of agents; observed literals in NDJSON, CSV and Parquet.

    OUT gets a file of intervals for each log (results/*.parquet), all of them as results.ndjson, and what
    became of each log in logs.ndjson. The same command goes on where it was killed. Exit code 2 says that a
    log was bad; the others are diagnosed nevertheless.
    """
    from robomend_batch.starting import started, usable_cores

    if given["scheduler"] is not None and given["workers"] is not None:
        raise click.UsageError("--scheduler and --workers: one or the other")
    names, problems = find_logs(logs)
    for name, reason in problems:
        click.echo(f"bad: {name}: {reason}", err=True)
    asked = usable_cores() if given["workers"] is None else given["workers"]
    workers = 0 if given["scheduler"] is not None else min(asked, len(names))
    with started(workers) as begun:
        summary = _diagnosed(names, model, out, begun, **{**given, "workers": workers})
    tell(summary, out)
    if summary.lost:
        return BACKEND_FAILED
    if problems or summary.bad:
        return BAD_INPUT
    return FAULT if given["fail_on_fault"] and summary.faulty else 0


def _diagnosed(names: list[str], model: str, out: Path, begun: list[Started], **given: Any) -> Summary:
    from robomend_batch.observing import check_declared, load_observers
    from robomend_batch.one_log import Setup
    from robomend_batch.progress import Progress
    from robomend_batch.run import run

    system = load(model)
    observers = given["observers"]
    if observers is not None:
        check_declared(
            load_observers(observers, code=given["code"]), system.vocabulary, given["unknown"], observers
        )
    return run(
        Setup(
            system,
            search_options(given, conflicts=False),
            out,
            given["unknown"],
            observers,
            given["time"] == "header",
            given["together"],
            code=given["code"],
            log_timeout_s=given["log_timeout"],
        ),
        names,
        overwrite=given["overwrite"],
        ndjson=given["ndjson"],
        parquet=given["parquet"],
        workers=given["workers"],
        scheduler=given["scheduler"],
        begun=begun,
        progress=lambda count, size: Progress(count, size, quiet=given["quiet"]),
    )


def tell(summary: Summary, out: Path) -> None:
    """Say on stderr what came out."""
    records = summary.records
    faulty = sum(1 for record in records if any(map(record["intervals"].get, ("faulty", "degraded"))))
    text = f"{counted(len(records), 'log')}, {faulty} with faults"
    contradictory = sum(1 for record in records if record["intervals"].get("contradictory"))
    if contradictory:
        text += f", {contradictory} with what the model cannot explain"
    for state, words in (
        ("unchecked", "without a checksum"),
        ("ended-early", "ended early"),
        ("bad", "read in part"),
        ("refused", "refused"),
        ("lost", "lost"),
    ):
        count = sum(1 for record in records if record["state"] == state)
        if count:
            text += f", {count} {words}"
    click.echo(f"{text}; results in {out}", err=True)
