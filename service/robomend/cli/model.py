"""`robomend model`: what is done with a model by itself."""

from __future__ import annotations

import math
from pathlib import Path

import click

from robomend.cli.commands import LazyGroup, Table
from robomend.cli.files import ExistingFile
from robomend.cli.models import MODEL, load
from robomend_client.counts import counted

COMMANDS: Table = {
    "check": ("robomend.cli.model:check", "Say what a model leaves out."),
    "from-ros": ("robomend.cli.model_from_ros:command", "Propose a model from a live ROS graph."),
}


@click.group("model", cls=LazyGroup, table=COMMANDS)
def command() -> None:
    """Check a model."""


@click.command("check")
@click.argument("model", type=MODEL)
@click.option("--strict", is_flag=True, help="Exit with 1 when there is a warning.")
@click.option("--format", "format_", type=click.Choice(("table", "json")), default="table", show_default=True)
@click.option("--isolability", is_flag=True, help="Which faults can be detected and told apart, instead.")
@click.option("--robot", type=ExistingFile(), help="A robot's configuration (YAML or JSON): what it reports.")
@click.option("--agent", "agents", type=ExistingFile(), multiple=True, help="An agent's file; repeatable.")
@click.option("--observe", "-o", multiple=True, metavar="ATOM", help='At hand, e.g. "ok(scan)"; repeatable.')
@click.option("--double", is_flag=True, help="Compare double faults, too.")
@click.option("--svg", type=click.Path(dir_okay=False, path_type=Path), help="Draw the matrix here.")
@click.option("--timeout", type=float, default=60.0, show_default=True, help="Seconds; inf: none.")
def check(
    model: str,
    strict: bool,
    format_: str,
    isolability: bool,
    robot: Path | None,
    agents: tuple[Path, ...],
    observe: tuple[str, ...],
    double: bool,
    svg: Path | None,
    timeout: float,
) -> int:
    """Say what MODEL leaves out: components that no rule can blame, names that nothing uses.

    With --isolability, say which faults can be detected and told apart by the observables at hand (--robot,
    --agent, --observe; without these, all that the rules speak of), and what would split the rest.

    A model that is wrong is refused with its file and line, and exit code 2.
    """
    if isolability:
        from robomend.cli.isolability import report

        if math.isnan(timeout) or timeout <= 0:
            raise click.UsageError("--timeout is a number of seconds above 0")
        report(
            load(model),
            robot=robot,
            agents=agents,
            observe=observe,
            double=double,
            timeout_s=None if math.isinf(timeout) else timeout,
            svg=svg,
            as_json=format_ == "json",
        )
        return 0
    if robot or agents or observe or double or svg:
        raise click.UsageError("--robot, --agent, --observe, --double and --svg are for --isolability")
    import json

    from robomend.model.checking import check as doubts

    system = load(model)
    warnings = doubts(system)
    cnf = system.cnf
    if format_ == "json":
        summary = {
            "name": system.name,
            "format": system.format,
            "components": len(cnf.components),
            "clauses": len(cnf.clauses),
            "atoms": len(cnf.atoms),
            "warnings": warnings,
        }
        click.echo(json.dumps(summary, ensure_ascii=False, separators=(",", ":")))
    else:
        click.echo(
            f"{system.name}: {system.format} model, {counted(len(cnf.components), 'component')}, "
            f"{counted(len(cnf.clauses), 'clause')}, {counted(len(cnf.atoms), 'observable atom')}"
        )
        for warning in warnings:
            click.echo(f"warning: {warning}")
    return 1 if strict and warnings else 0
