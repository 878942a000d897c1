"""Benchmarks of several parts: which of them run (`--only speed,alarms`), and how their figures are shown.

A part gives its figures by what they are of: numbers and texts, or figures again.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Collection
from typing import Any

import click

from robomend_client.counts import first_few

Figures = dict[str, Any]

LISTED = 5
"""Of a list, in the table; of what is amiss, a fleet has thousands."""


def only(parts: Collection[str]) -> Callable[[Any], Any]:
    """Return the option `--only`: the parts that it names, all if it names none; others are refused."""

    def named(context: click.Context, parameter: click.Parameter, value: str) -> tuple[str, ...]:
        names = tuple(filter(None, value.split(","))) or tuple(parts)
        for name in names:
            if name not in parts:
                raise click.BadParameter(f"{name!r} is none of {', '.join(parts)}")
        return names

    told = f"Parts, comma-separated: {', '.join(parts)}."
    return click.option("--only", "parts", callback=named, default="", help=told)


def report(parts: Collection[str], measure: Callable[[str], Figures], output: str) -> dict[str, Figures]:
    """Measure these parts, print what came out as a table or as JSON, and return it."""
    found: dict[str, Figures] = {}
    for part in parts:
        click.echo(f"measuring: {part}", err=True)
        found[part] = measure(part)
    if output == "json":
        click.echo(json.dumps(found, indent=1))
        return found
    # Above its cores, nobody's latency is the program's own.
    click.echo(f"{len(os.sched_getaffinity(0))} cores, load {os.getloadavg()[0]:.1f}\n")
    click.echo("| part | what | measured |\n|---|---|---|")
    for part, figures in found.items():
        for what, figure in figures.items():
            click.echo(f"| {part} | {what} | {shown(figure)} |")
    return found


def shown(figure: Any) -> str:
    """Return a figure as the table has it."""
    if isinstance(figure, dict):
        return ", ".join(f"{name} {shown(one)}" for name, one in figure.items()) or "none"
    if isinstance(figure, list):
        return first_few([shown(one) for one in figure], LISTED, "; ") or "none"
    if isinstance(figure, int | float):
        return f"{figure:,}"
    return str(figure)
