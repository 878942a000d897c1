"""`robomend-batch priors`: confirmed faults in, the priors of a model out."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click

from robomend.cli.files import ExistingFile
from robomend.cli.models import MODEL, load

TOLD = ("ok", "unchecked", "ended-early", "bad")
"""States of logs that were diagnosed."""


@click.command("priors")
@click.argument("confirmed", type=ExistingFile())
@click.option("--model", "-m", type=MODEL, required=True, help="Whose components they are.")
@click.option(
    "--results",
    "-r",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Of a list: the folder of the run over all logs, with a fault or without.",
)
@click.option(
    "--confidence",
    type=click.FloatRange(0.5, 0.999),
    default=0.95,
    show_default=True,
    help="Of the intervals.",
)
@click.option(
    "--format", "format_", type=click.Choice(("table", "ndjson", "yaml")), default="table", show_default=True
)
def command(confirmed: Path, model: str, results: Path | None, confidence: float, format_: str) -> None:
    """Estimate the priors of a model's components from faults that were CONFIRMED.

    CONFIRMED is a list (CSV or NDJSON) with `log` and `component`, to be counted among the logs of a run
    (--results); or a service's own history, as `robomend export` writes it: there the repairs that helped
    confirm what they repaired, and the days of each robot are counted.

    \b
    robomend-batch priors confirmed.csv -m my_robot.yaml -r out
    robomend export -o history.ndjson
    robomend-batch priors history.ndjson -m my_robot.yaml --format yaml
    """
    from robomend_batch.logs.export import MAGIC
    from robomend_batch.priors import of_export, of_list, priors
    from robomend_batch.results import Results

    with confirmed.open("rb") as file:
        exported = file.read(len(MAGIC)) == MAGIC
    if exported == (results is not None):
        why = "a history counts days: it needs no --results" if exported else "a list needs --results"
        raise click.UsageError(why)
    if exported:
        counted = of_export(confirmed)
    else:
        assert results is not None
        logs = frozenset(one["log"] for one in Results(results).records if one["state"] in TOLD)
        counted = of_list(confirmed, logs)
    found = priors(load(model).cnf.components, counted, confidence)
    if format_ == "ndjson":
        for one in found:
            click.echo(json.dumps(asdict(one), ensure_ascii=False, separators=(",", ":")))
        return
    if format_ == "yaml":
        click.echo(
            f"# Of {len(counted.occasions):,} {counted.unit}, with {confidence:.0%} intervals: "
            "`prior:` goes into the entry of each in the model."
        )
        for one in found:
            name = json.dumps(one.component, ensure_ascii=False)
            why = f"{one.faults} of {one.occasions}; {one.low:.2g} to {one.high:.2g}"
            click.echo(f"{name}: {{prior: {one.prior:.3g}}}    # {why}")
        return
    width = max(len("component"), *(len(one.component) for one in found))
    click.echo(f"of {len(counted.occasions):,} {counted.unit}; {confidence:.0%} intervals\n")
    click.echo(f"{'component':{width}}  faults  prior     interval")
    for one in found:
        click.echo(
            f"{one.component:{width}}  {one.faults:6}  {one.prior:<8.3g}  {one.low:.2g} to {one.high:.2g}"
        )
