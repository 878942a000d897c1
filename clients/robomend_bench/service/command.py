"""The command `robomend-bench service`: what a running service takes, and how fast it answers.

It starts a service of its own on a free port and an empty folder, or measures one that runs (`--url`). The
generator shares the machine with the service, as on a robot; its own share and its lateness are reported.
"""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Coroutine
from typing import Any

import click

from robomend_bench.parts import only
from robomend_bench.service.measure import load_of_others
from robomend_bench.service.parts import MEASURES, Measured, Row, measure_start, measure_stop
from robomend_bench.service.process import processors, reached

LISTED = 5
"""Of what is amiss, on one line; a fleet has thousands."""

PARTS = (
    "start",
    "single",
    "fleet",
    "memory",
    "posts",
    "ndjson",
    "hostile",
    "pages",
    "stop",
    "stop-under-attack",
    "strangers",
    "overload",
    "growth",
    "beside-bare",
    "fleet-beside-bare",
)


@click.command("service", context_settings={"help_option_names": ["-h", "--help"]})
@only(PARTS)
@click.option("--robots", type=click.IntRange(1, 20_000), default=1000, show_default=True)
@click.option(
    "--rate", type=click.FloatRange(0.01, 100), default=1.0, show_default=True, help="Changes a second, each."
)
@click.option(
    "--seconds",
    type=click.FloatRange(0.1, 86_400),
    default=20.0,
    show_default=True,
    help="The documented figures are of 300.",
)
@click.option("--faults", type=click.IntRange(1, 11), default=3, show_default=True, help="At most, a robot.")
@click.option("--changes", type=click.IntRange(10), default=300, show_default=True, help="In part single.")
@click.option("--writers", type=click.IntRange(1, 2000), default=64, show_default=True, help="In part posts.")
@click.option("--observations", type=click.IntRange(100), default=200_000, help="In part ndjson.")
@click.option(
    "--moments", type=click.IntRange(1, 10_000), default=40, show_default=True, help="In part stop."
)
@click.option(
    "--attackers", type=click.IntRange(1, 500), default=20, show_default=True, help="In stop-under-attack."
)
@click.option("--pages", type=click.IntRange(1, 500), default=50, show_default=True, help="In part pages.")
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("--url", help="Measure a service that runs already; robots named r0, r1, … are put there.")
@click.option("--database", help="URL of a PostgreSQL database for the service, instead of SQLite.")
@click.option("--format", "output", type=click.Choice(["markdown", "json"]), default="markdown")
def command(parts: tuple[str, ...], output: str, url: str | None, **wish: Any) -> None:
    """Measure `robomend serve` under load.

    \b
    robomend-bench service --robots 1000 --rate 1 --seconds 60
    robomend-bench service --only single,posts --format json
    robomend-bench service --only fleet --seconds 300
    robomend-bench service --only stop --moments 40
    robomend-bench service --only stop-under-attack --seconds 60
    """
    results, rows = run_parts(parts, url, **wish)
    if output == "json":
        click.echo(json.dumps(results, indent=1))
    else:
        click.echo(f"{processors()} cores, generator on the same machine, load {load_of_others():.1f}\n")
        click.echo("| what | measured | goal |\n|---|---|---|")
        for what, measured, goal in rows:
            click.echo(f"| {what} | {measured} | {goal} |")
    amiss = [f"{part}: {said}" for part, result in results.items() if (said := _amiss(result))]
    for line in amiss:
        click.echo(line, err=True)
    if amiss:
        sys.exit(1)


def _amiss(result: dict[str, Any]) -> str:
    """Return what a part has that no figure excuses; nothing if all was answered, and kept."""
    return ", ".join(f"{what}: {_listed(result[what])}" for what in ("errors", "lost") if result.get(what))


def _listed(found: Any) -> str:
    if isinstance(found, dict):
        return "; ".join(f"{count} × {name}" for name, count in found.items())
    if not isinstance(found, list | tuple):
        return str(found)
    more = f"; and {len(found) - LISTED} more" if len(found) > LISTED else ""
    return "; ".join(map(str, found[:LISTED])) + more


def run_parts(
    parts: tuple[str, ...], url: str | None, *, database: str | None, **wish: Any
) -> tuple[dict[str, dict[str, Any]], list[Row]]:
    """Measure each part on a service of its own, and return the figures and the table."""
    arguments = [*(["--database", database] if database else [])]
    results: dict[str, dict[str, Any]] = {}
    rows: list[Row] = []
    for part in parts:
        click.echo(f"measuring: {part}", err=True)
        if part == "start":
            found, more = measure_start(arguments)
        elif part == "stop":
            if url is not None:
                raise click.UsageError("part stop needs services of its own; leave out --url")
            found, more = _run(measure_stop(arguments, wish))
        else:
            with reached(url, arguments) as (reachable, process):
                found, more = _run(MEASURES[part](reachable, process, wish | {"database": database}))
        results[part] = found
        rows += more
    return results, rows


def _run(work: Coroutine[Any, Any, Measured] | Measured) -> Measured:
    if isinstance(work, tuple):  # it is done
        return work
    try:
        import uvloop
    except ImportError:
        return asyncio.run(work)
    return uvloop.run(work)
