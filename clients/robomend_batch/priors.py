"""`robomend-batch priors`: how often was each component found to be broken? From confirmed faults to priors.

    confirmed: k of n logs (or days of a robot)  ──►  prior (k + ½) / (n + 1), and an interval for it

The prior is the mean of Beta(k + ½, n − k + ½): with Jeffreys' prior, a component that never failed has a
small probability and not none, as a model's prior must be above 0. The interval is Wilson's.

Confirmed is a fault that a person, or a repair that helped, says was there; a diagnosis alone is no
confirmation: priors from diagnoses would confirm themselves.

Sources:
    E. Wilson. Probable inference, the law of succession, and statistical inference. JASA 22, 1927.
    L. Brown, T. Cai, A. DasGupta. Interval estimation for a binomial proportion. Stat. Sci. 16(2), 2001.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from math import sqrt
from pathlib import Path
from statistics import NormalDist

import click

from robomend.cli.files import ExistingFile
from robomend.cli.models import MODEL, load
from robomend.errors import InputError
from robomend_batch.logs.export import MAGIC, ExportEnd, batch_rows
from robomend_batch.logs.text import Line, csv_lines, ndjson_lines
from robomend_batch.results import Results
from robomend_client.observers.base import SECOND

DAY_NS = 86400 * SECOND

TOLD = ("ok", "unchecked", "ended-early", "bad")
"""States of logs that were diagnosed."""


@dataclass(frozen=True, slots=True)
class Confirmed:
    """What was confirmed, and of how many occasions."""

    occasions: frozenset[str]  # on which the robots were looked at
    faults: dict[str, frozenset[str]]  # component -> occasions on which it was broken
    unit: str  # of the occasions: "logs", "robot-days"


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of a component."""

    component: str
    faults: int
    occasions: int
    prior: float
    low: float
    high: float


def priors(components: Iterable[str], confirmed: Confirmed, confidence: float = 0.95) -> list[Prior]:
    """Return the priors of components, in their order.

    Raises:
        InputError: a confirmed fault is of another component, or nothing was looked at.
    """
    names = list(components)
    strange = sorted(confirmed.faults.keys() - set(names))
    if strange:
        raise InputError(f"the model has no component {', '.join(strange)}")
    n = len(confirmed.occasions)
    if not n:
        raise InputError(f"there are no {confirmed.unit} to count faults of")
    found = []
    for name in names:
        k = len(confirmed.faults.get(name, ()))
        low, high = wilson(k, n, confidence)
        found.append(Prior(name, k, n, (k + 0.5) / (n + 1), low, high))
    return found


def wilson(k: int, n: int, confidence: float) -> tuple[float, float]:
    """Return the interval for a probability of which k of n trials were seen."""
    z = NormalDist().inv_cdf(0.5 + confidence / 2)
    middle = (k + z * z / 2) / (n + z * z)
    half = z / (n + z * z) * sqrt(k * (n - k) / n + z * z / 4)
    return max(0.0, middle - half), min(1.0, middle + half)


def of_export(file: Path) -> Confirmed:
    """Return what a service's history confirms: the repairs that helped, by robot and day (UTC); none that
    answered a drill.

    Days on which a robot reported nothing are none.
    """
    days: set[str] = set()
    faults: dict[str, set[str]] = {}
    end = ExportEnd()
    for _, batch, row in batch_rows(file, frozenset({"tried"}), end):
        day = f"{row['robot']} {row['time_ns'] // DAY_NS}"
        days.add(day)
        # A drill's fault was planted: it says nothing of how often a component breaks.
        if batch is None and row["helped"] and json.loads(row["data"]).get("drill") is None:
            for component in json.loads(row["bad"]):
                faults.setdefault(component, set()).add(day)
    if not end.whole:
        raise InputError(f"{file}: cut off: an export ends with a line that says so")
    return Confirmed(
        frozenset(days), {name: frozenset(found) for name, found in faults.items()}, "robot-days"
    )


def of_list(file: Path, logs: frozenset[str]) -> Confirmed:
    """Return what a list confirms: lines with `log` and `component`, in CSV or NDJSON.

    Args:
        file: the list.
        logs: that were looked at, with a fault or without.

    Raises:
        InputError: with the line that cannot be used.
    """
    faults: dict[str, set[str]] = {}
    lines: Iterable[Line] = csv_lines(file) if file.suffix.lower() == ".csv" else ndjson_lines(file)
    for number, _, line in lines:
        if isinstance(line, str):
            raise InputError(f"{file}:{number}: {line}")
        log, component = line.get("log"), line.get("component")
        if not isinstance(log, str) or not isinstance(component, str):
            raise InputError(f"{file}:{number}: a `log` and a `component` are needed")
        if log not in logs:
            raise InputError(f"{file}:{number}: {log} is none of the logs in the results")
        faults.setdefault(component, set()).add(log)
    return Confirmed(logs, {name: frozenset(found) for name, found in faults.items()}, "logs")


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
