"""`robomend diagnose`: observations in, minimal diagnoses out; one set, or a file of many."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from robomend.cli.completion import PartName, components_option
from robomend.cli.files import near_file
from robomend.cli.models import MODEL, is_snapshot_file, load, search_options
from robomend.diagnosis.engines import DEFAULT, ENGINES
from robomend_client.counts import counted

if TYPE_CHECKING:
    from robomend.diagnosis.probes import ProbeResult
    from robomend.diagnosis.result import DiagnosisResult, Options
    from robomend.model.cnf import HealthCnf
    from robomend.model.system import System
    from robomend.oneshots.warm_model import Question, WarmModel
    from robomend_client.literals import Literal

PROBES_S = 0.5
"""For finding out what to look at next: it comes on top of the diagnosis."""


@click.command("diagnose")
@click.argument("model", type=MODEL)
@click.option("--observe", "-o", multiple=True, metavar="SENTENCE", help='E.g. "not ok(scan)"; repeatable.')
@click.option(
    "--observations",
    type=click.Path(allow_dash=True),
    metavar="FILE",
    help="One set per line: a JSON array, or literals; - is stdin.",
)
@click.option("--together", is_flag=True, help="One answer for all lines: the faults are the same.")
@click.option(
    "--engine",
    type=PartName("engine", ENGINES.names),
    default=DEFAULT,
    show_default=True,
    help=f"{', '.join(ENGINES.built_in)}, or one installed.",
)
@click.option("--minimal", type=click.Choice(("cardinality", "subset")), default="subset", show_default=True)
@click.option("--max-size", type=click.IntRange(min=0), help="No diagnosis larger than this.")
@click.option("--limit", type=click.IntRange(min=0), default=100, show_default=True, help="0: no limit.")
@click.option("--timeout", type=float, default=5.0, show_default=True, help="Seconds per set; inf: none.")
@click.option("--order", type=click.Choice(("size", "probability")), default="size", show_default=True)
@click.option("--factored", is_flag=True, help="Diagnoses as products of alternatives, with the exact count.")
@click.option(
    "--conflicts/--no-conflicts", default=True, show_default=True, help="Say what clashes with what."
)
@click.option(
    "--all-conflicts",
    is_flag=True,
    help="Every minimal conflict, not only enough to show why each is blamed.",
)
@components_option("--assume-healthy", "What if it is healthy?")
@components_option("--assume-abnormal", "What if it is abnormal?")
@components_option("--expect-stopped", "This is meant to be off.")
@click.option("--unknown", type=click.Choice(("refuse", "keep")), default="refuse", help="Undeclared names.")
@click.option("--fail-on-fault", is_flag=True, help="Exit with 1 unless everything is healthy.")
@click.option(
    "--all",
    "all_",
    is_flag=True,
    help="Every diagnosis and conflict, and why other suspects are cleared.",
)
@click.option(
    "--format", "format_", type=click.Choice(("table", "json")), help="Default: table; json for files."
)
def command(model: str, **given: Any) -> int:
    """Explain observations of MODEL by minimal diagnoses.

    MODEL is a component model, a five-key model, or a circuit in .bench form (each gate a component,
    `v(NET)` its wires, `not v(NET)` for 0). With --observations, one JSON object is written per line, in
    order; a line that is refused gets an object with `error` in its place, and the exit code is 2. With
    --together the lines are snapshots of one robot whose faults are the same in all of them, and one answer
    explains them all; so do the snapshots of a MODEL with several observations (.wcnf, .wcnf.gz).
    """
    if given["together"] and given["observations"] is None:
        raise click.UsageError("--together needs --observations FILE, one snapshot a line")
    if is_snapshot_file(model):
        return _snapshot_file(model, given)
    system = load(model)
    from robomend.cli.diagnosis_text import PROBES, leading_first
    from robomend.oneshots.warm_model import WarmModel

    for warning in system.warnings:
        click.echo(f"warning: {warning}", err=True)
    if given["observations"] is not None and given["format_"] == "table" and not given["together"]:
        raise click.UsageError("--observations writes JSON lines; leave out --format table")
    if given["observations"] is not None and given["observe"]:
        raise click.UsageError("give either --observe or --observations")
    probes = None
    with WarmModel(
        system,
        given["engine"],
        _options(given),
        unknown=given["unknown"],
        expected_stopped=given["expect_stopped"],
    ) as warm:
        if given["together"]:
            result = warm.ask_together(_snapshots(warm, given["observations"]))
        elif given["observations"] is not None:
            return _many(warm, given["observations"], given["fail_on_fault"])
        else:
            asked = warm.question(given["observe"])
            result = warm.ask(asked).result
            if result.healthy:
                _say_what_is_excused(system, asked.literals)
            if given["format_"] != "json" and not given["factored"]:
                result = leading_first(result)
                probes = warm.probes(asked, result, limit=PROBES, timeout_s=PROBES_S)
    blind = not given["observe"] and not given["together"]
    return _one(result, system.cnf, given, probes, repairable=system.parts is not None, blind=blind)


def _say_what_is_excused(system: System, observed: Collection[Literal]) -> None:
    """Warn of topics that were seen silent while nobody is blamed: they wait, in a circle or for an input."""
    from robomend.model.checking import excused

    silent = {
        one.atom.args[0]
        for one in observed
        if not one.positive and one.atom.predicate == "ok" and len(one.atom.args) == 1
    }
    for sentence in excused(system, silent) if silent else ():
        click.echo(f"warning: {sentence}", err=True)


def _one(
    result: DiagnosisResult,
    cnf: HealthCnf,
    given: dict[str, Any],
    probes: ProbeResult | None = None,
    *,
    repairable: bool = False,
    blind: bool = False,
) -> int:
    """Write one answer; return the exit code."""
    from robomend.cli.diagnosis_text import leading_first, told
    from robomend.oneshots.result_json import quoted_names, result_text

    for literal in result.unused:
        click.echo(f"warning: no rule mentions {literal.atom}: observing it says nothing", err=True)
    if given["format_"] == "json":
        click.echo(result_text(result, quoted_names(result.components)))
    else:
        lines = told(
            leading_first(result),
            probes,
            everything=given["all_"],
            repairable=repairable,
            blind=blind,
        )
        click.echo("\n".join(lines))
    if result.stopped_by == "limit" and cnf.circuit and not given["factored"] and not given["together"]:
        found = len(result.diagnoses)
        click.echo(
            f"note: there are more than {found} diagnoses; --minimal cardinality --factored counts those of "
            "least size without listing them",
            err=True,
        )
    return 1 if given["fail_on_fault"] and not result.healthy else 0


def _snapshot_file(model: str, given: dict[str, Any]) -> int:
    """Answer the snapshots of a .wcnf file."""
    from robomend.diagnosis.wcnf import read_wcnf
    from robomend.errors import ModelError
    from robomend.oneshots.warm_model import explain_snapshots

    if given["observe"] or given["observations"] is not None:
        raise click.UsageError("a .wcnf file has its observations in it: leave out --observe/--observations")
    if given["expect_stopped"]:
        raise click.UsageError("--expect-stopped is for robots; a .wcnf file is a circuit")
    try:
        read = read_wcnf(Path(model))
    except OSError as error:
        raise ModelError(f"cannot be read: {error.strerror or error}{near_file(model)}", model) from error
    return _one(
        explain_snapshots(read.cnf, read.snapshots, given["engine"], _options(given)), read.cnf, given
    )


def _options(given: dict[str, Any]) -> Options:
    return search_options(
        given,
        order=given["order"],
        conflicts="all" if given["all_conflicts"] else given["conflicts"],
        factored=given["factored"],
        healthy=frozenset(given["assume_healthy"]),
        abnormal=frozenset(given["assume_abnormal"]),
    )


def _many(warm: WarmModel, path: str, fail_on_fault: bool) -> int:
    """Write one line per set, in order; return the exit code.

    A set that is refused, or contradicts the model, gets `{"error": {"code": …, "message": …}}` in its place.
    """
    from robomend.errors import InputError
    from robomend.model.other_formats import named

    refused = lines = 0
    all_healthy = True
    write, clock = sys.stdout.write, time.perf_counter
    for line in _lines(path):
        if not lines and (other := named(line)):
            raise InputError(f"{path}: {other}")
        lines += 1
        began = clock()
        try:
            explained = warm.ask_line(line)
        except InputError as error:
            problem = {"error": {"code": error.code, "message": str(error)}}
            text = json.dumps(problem, ensure_ascii=False, separators=(",", ":"))
            refused += 1
        else:
            text = explained.text(clock() - began)
            all_healthy = all_healthy and explained.healthy
        write(text + "\n")
        if path == "-":  # somebody waits at the other end
            sys.stdout.flush()
    if refused:
        click.echo(
            f"error: refused {refused} of {counted(lines, 'set')}: see `error` in their lines", err=True
        )
        return 2
    return 1 if fail_on_fault and not all_healthy else 0


def _snapshots(warm: WarmModel, path: str) -> Iterator[Question]:
    """Yield the set of each line; one that is missing would change the answer, so each must be readable."""
    from robomend.errors import InputError
    from robomend.oneshots.warm_model import sentences_of

    for number, line in enumerate(_lines(path), 1):
        try:
            yield warm.question(sentences_of(line))
        except InputError as error:
            raise InputError(f"snapshot {number}: {error}") from error


def _lines(path: str) -> Iterator[str]:
    """Yield the lines of a file that say something, `-` for stdin; InputError if it cannot be read."""
    from robomend.errors import InputError

    try:
        if path == "-":
            yield from (line for line in sys.stdin if line.strip())
        else:
            with Path(path).open(encoding="utf-8") as file:
                yield from (line for line in file if line.strip())
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}{near_file(path)}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not UTF-8 text") from error
