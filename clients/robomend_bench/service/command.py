"""The command `robomend-bench service`: what a running service takes, and how fast it answers.

It starts a service of its own on a free port and an empty folder, or measures one that runs (`--url`). The
generator shares the machine with the service, as on a robot; its lateness is reported.
"""

from __future__ import annotations

import asyncio
import sys
import tempfile
from collections.abc import Coroutine
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import click

from robomend_bench.parts import Figures, only, report, shown
from robomend_bench.service.attack import run_attack
from robomend_bench.service.load import (
    SimulatedRobot,
    prepare,
    run_fleet,
    run_growth,
    run_ndjson,
    run_overload,
    run_posts,
    run_single,
)
from robomend_bench.service.process import Served, children, memory_mb, served, start
from robomend_bench.service.stops import run_stops

WARM_UP_S = 3.0
"""The service's workers warm up beside it; and what it takes at rest is what it takes then."""

PARTS = (
    "start",
    "single",
    "fleet",
    "memory",
    "posts",
    "ndjson",
    "stop",
    "stop-under-attack",
    "overload",
    "growth",
)

OWN = frozenset({"start", "memory", "stop", "stop-under-attack", "growth"})
"""Parts that need a service of their own."""

GROWTH_CHANGES = 1000

STOP_ROBOTS = 4
"""Under repair at a time: each has a board of its own."""


@click.command("service", context_settings={"help_option_names": ["-h", "--help"]})
@only(PARTS)
@click.option("--robots", type=click.IntRange(1, 20_000), default=1000, show_default=True)
@click.option(
    "--rate", type=click.FloatRange(0.01, 100), default=1.0, show_default=True, help="Changes a second, each."
)
@click.option("--seconds", type=click.FloatRange(0.1, 86_400), default=20.0, show_default=True)
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
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("--url", help="Measure a service that runs already; robots named r0, r1, … are put there.")
@click.option("--database", help="URL of a PostgreSQL database for the service, instead of SQLite.")
@click.option("--format", "output", type=click.Choice(["markdown", "json"]), default="markdown")
def command(parts: tuple[str, ...], output: str, url: str | None, database: str | None, **wish: Any) -> None:
    """Measure `robomend serve` under load.

    \b
    robomend-bench service --robots 1000 --rate 1 --seconds 60
    robomend-bench service --only single,posts --format json
    robomend-bench service --only fleet --seconds 300
    robomend-bench service --only stop --moments 40
    robomend-bench service --only stop-under-attack --seconds 60
    """
    if url is not None and (own := OWN.intersection(parts)):
        raise click.UsageError(f"part {min(own)} needs a service of its own; leave out --url")
    if database is not None and "growth" in parts:
        raise click.UsageError("part growth needs SQLite; leave out --database")
    arguments = ["--database", database] if database else []
    found = report(parts, lambda part: measure(part, url, arguments, wish), output)
    amiss = [
        f"{part}: {', '.join(f'{what}: {shown(figures[what])}' for what in wrong)}"
        for part, figures in found.items()
        if (wrong := [what for what in ("errors", "lost") if figures.get(what)])
    ]
    for line in amiss:
        click.echo(line, err=True)
    if amiss:
        sys.exit(1)


def measure(part: str, url: str | None, arguments: list[str], wish: dict[str, Any]) -> Figures:
    """Measure a part on a service of its own, unless there is a URL."""
    if part == "start":
        return measure_start(arguments)
    if part == "stop":
        count = min(wish["robots"], STOP_ROBOTS)
        return _run(run_stops(arguments, moments=wish["moments"], count=count, seed=wish["seed"]))
    with nullcontext(None) if url else served(arguments) as process:
        if process is None:
            return _run(_loaded(part, str(url).rstrip("/"), wish))
        if part == "stop-under-attack":
            seconds = min(wish["seconds"], 300.0)
            return run_attack(process, clients=wish["attackers"], seconds=seconds, seed=wish["seed"])
        if part == "growth":
            robots = min(wish["robots"], 50)
            return _run(run_growth(process, robots=robots, changes=GROWTH_CHANGES, seed=wish["seed"]))
        if part == "memory":
            return _run(_memory(process, wish))
        return _run(_loaded(part, process.url, wish))


def _run(work: Coroutine[Any, Any, Figures]) -> Figures:
    try:
        import uvloop
    except ImportError:
        return asyncio.run(work)
    return uvloop.run(work)


def measure_start(arguments: list[str]) -> Figures:
    """Measure how long services take to begin, each on the folder of the one before."""
    with tempfile.TemporaryDirectory(prefix="robomend-bench-") as folder:
        times = []
        for _ in range(4):
            service = start(Path(folder), arguments)
            times.append(round(service.ready_s, 2))
            service.stop()
            assert service.process.stdout is not None
            service.process.stdout.close()
    return {"ready_s": times[1:], "first_ready_s": times[0]}


async def _loaded(part: str, url: str, wish: dict[str, Any]) -> Figures:
    """Measure a part that needs nothing but a URL."""
    seed, robots, seconds = wish["seed"], wish["robots"], wish["seconds"]
    if part == "fleet":
        fleet = [SimulatedRobot(f"r{n}", seed, faults=wish["faults"]) for n in range(robots)]
        await prepare(url, fleet)
        return await run_fleet(url, fleet, rate_hz=wish["rate"], seconds=seconds, seed=seed)
    if part == "posts":
        return await run_posts(url, writers=wish["writers"], seconds=min(seconds, 60.0))
    if part == "ndjson":
        return {
            f"per_line_{per_line}": await run_ndjson(
                url, observations=wish["observations"], per_line=per_line
            )
            for per_line in (1, 10)
        }
    await asyncio.sleep(WARM_UP_S)
    if part == "overload":
        return await run_overload(url, robots=robots, seconds=seconds, writers=wish["writers"], seed=seed)
    return {
        name: await run_single(url, changes=wish["changes"], pause_s=pause_s, seed=seed)
        for name, pause_s in (("one after another", 0.0), ("10 ms apart", 0.01))
    }


async def _memory(process: Served, wish: dict[str, Any]) -> Figures:
    await asyncio.sleep(WARM_UP_S)
    idle = memory_mb(process.pid)
    workers = [round(memory_mb(pid), 1) for pid in children(process.pid)]
    robots = [SimulatedRobot(f"r{n}", wish["seed"]) for n in range(wish["robots"])]
    first = len(robots) // 10 or 1
    await prepare(process.url, robots[:first])  # what is paid once: code loaded on first use, connections
    few = memory_mb(process.pid)
    await prepare(process.url, robots[first:])
    many = memory_mb(process.pid)
    further = round((many - few) / max(1, len(robots) - first), 3)
    return {"idle_mb": round(idle, 1), "workers_mb": workers, "mb_a_robot": further, "mb": round(many, 1)}
