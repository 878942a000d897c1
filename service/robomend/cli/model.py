"""`robomend model`: what is done with a model by itself."""

from __future__ import annotations

import click

from robomend.cli.lazy import LazyGroup, Table
from robomend.cli.models import MODEL, load

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
def check(model: str, strict: bool, format_: str) -> int:
    """Say what MODEL leaves out: components that no rule can blame, names that nothing uses.

    A model that is wrong is refused with its file and line, and exit code 2.
    """
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
            f"{system.name}: {system.format} model, {len(cnf.components)} components, "
            f"{len(cnf.clauses)} clauses, {len(cnf.atoms)} observable atoms"
        )
        for warning in warnings:
            click.echo(f"warning: {warning}")
    return 1 if strict and warnings else 0
