"""The command `robomend-bench service`: what a running service takes, and how fast it answers.

It starts a service of its own on a free port and an empty folder, or measures one that runs (`--url`). The
generator shares the machine with the service, as on a robot; its own share and its lateness are reported.
"""

from __future__ import annotations

import asyncio
import json
import sys
import tempfile
from collections.abc import Callable, Coroutine
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from robomend_bench.parts import only
from robomend_bench.service.attack import run_attack
from robomend_bench.service.load import (
    FleetResult,
    SimulatedRobot,
    prepare,
    run_fleet,
    run_growth,
    run_ndjson,
    run_overload,
    run_posts,
    run_single,
)
from robomend_bench.service.process import (
    Served,
    children,
    load_of_others,
    memory_mb,
    processors,
    reached,
    start,
)
from robomend_bench.service.stops import run_stops

Row = tuple[str, str, str]
"""What was measured, what came out, the goal."""

Measured = tuple[dict[str, Any], list[Row]]

WARM_UP_S = 3.0
"""The service's workers warm up beside it; and what it takes at rest is what it takes then."""

LISTED = 5
"""Of what is amiss, on one line; a fleet has thousands."""

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
        elif part == "stop" and url is None:
            found, more = _run(measure_stop(arguments, wish))
        elif part in OWN and url is not None:
            raise click.UsageError(f"part {part} needs a service of its own; leave out --url")
        elif part == "growth" and database is not None:
            raise click.UsageError("part growth needs SQLite; leave out --database")
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


# --- the parts


def measure_start(arguments: list[str]) -> Measured:
    """Measure how long services take to begin, each on the folder of the one before."""
    with tempfile.TemporaryDirectory(prefix="robomend-bench-") as folder:
        times = []
        for _ in range(4):
            service = start(Path(folder), arguments)
            times.append(round(service.ready_s, 2))
            service.stop()
            assert service.process.stdout is not None
            service.process.stdout.close()
    found = {"ready_s": times[1:], "first_ready_s": times[0]}
    shown = f"{max(times[1:]):.2f} s (worst of {len(times) - 1}; on an empty folder {times[0]:.2f} s)"
    return found, [("start to ready, schema current", shown, "< 3 s")]


async def _single(url: str, process: Served | None, wish: dict[str, Any]) -> Measured:
    await asyncio.sleep(WARM_UP_S)
    found: dict[str, Any] = {}
    rows = []
    for name, pause_s in (("one after another", 0.0), ("10 ms apart", 0.01)):
        result = await run_single(url, changes=wish["changes"], pause_s=pause_s, seed=wish["seed"])
        found[name] = asdict(result)
        what = f"one robot, changes {name}: POST to diagnosis event"
        rows.append((what, str(result.diagnosed), "p50 < 4, p99 < 15 ms"))
    return found, rows


async def _fleet(url: str, process: Served | None, wish: dict[str, Any]) -> Measured:
    robots = [SimulatedRobot(f"r{n}", wish["seed"], faults=wish["faults"]) for n in range(wish["robots"])]
    await prepare(url, robots)
    result = await run_fleet(
        url, robots, rate_hz=wish["rate"], seconds=wish["seconds"], seed=wish["seed"], served=process
    )
    return asdict(result), _fleet_rows(result)


def _fleet_rows(result: FleetResult) -> list[Row]:
    """Return the table's rows of an open-loop run."""
    name = f"{result.robots} robots, {result.asked_per_s:g} changes/s for {result.seconds:g} s"
    errors = sum(result.errors.values())
    said = f"{errors} errors, {len(result.lost)} robots differ, {result.undiagnosed} undiagnosed"
    service = (
        ""
        if result.service_cpu is None
        else f"service {result.service_cpu} cores ({result.cpu_ms_a_change} ms a change), "
    )
    return [
        (f"{name}: to the diagnosis event", str(result.diagnosed), "p50 < 20, p99 < 200 ms"),
        (f"{name}: to the acknowledgement", str(result.acknowledged), ""),
        (f"{name}: achieved", f"{result.achieved_per_s}/s; {said}", "all; 0, 0, 0"),
        (
            f"{name}: costs",
            f"{service}generator {result.generator_cpu}; sent late {result.sent_late}; load {result.load}; "
            f"{result.coalesced} diagnosed with a later change",
            "",
        ),
    ]


async def _memory(url: str, process: Served | None, wish: dict[str, Any]) -> Measured:
    assert process is not None
    await asyncio.sleep(WARM_UP_S)
    idle = memory_mb(process.pid)
    workers = [round(memory_mb(pid), 1) for pid in children(process.pid)]
    robots = [SimulatedRobot(f"r{n}", wish["seed"], faults=wish["faults"]) for n in range(wish["robots"])]
    first = len(robots) // 10 or 1
    await prepare(url, robots[:first])  # what is paid once: code loaded on first use, connections
    few = memory_mb(process.pid)
    await prepare(url, robots[first:])
    many = memory_mb(process.pid)
    further = round((many - few) / max(1, len(robots) - first), 3)
    found = {"idle_mb": round(idle, 1), "workers_mb": workers, "mb_a_robot": further, "mb": round(many, 1)}
    return found, [
        ("memory of the service process, idle", f"{idle:.0f} MB", "< 150 MB"),
        ("memory of its worker processes, each", ", ".join(f"{one:.0f} MB" for one in workers), ""),
        (f"memory a further robot ({len(robots)} robots)", f"{further} MB", "< 0.3 MB"),
    ]


async def _posts(url: str, process: Served | None, wish: dict[str, Any]) -> Measured:
    result = await run_posts(url, writers=wish["writers"], seconds=min(wish["seconds"], 60.0))
    shown = f"{result.per_s:.0f}/s ({result.errors} errors; {result.latency})"
    name = f"single durable POSTs, {result.writers} connections, each diagnosed"
    return asdict(result) | {"errors": result.errors}, [(name, shown, "≥ 1,200/s")]


async def _ndjson(url: str, process: Served | None, wish: dict[str, Any]) -> Measured:
    found: dict[str, Any] = {}
    rows = []
    for per_line in (1, 10):
        result = await run_ndjson(url, observations=wish["observations"], per_line=per_line)
        found[f"per_line_{per_line}"] = asdict(result)
        name = f"NDJSON, {per_line} observation{'s' if per_line > 1 else ''} a line"
        rows.append((name, f"{result.per_s:.0f} observations/s", "≥ 30,000/s"))
    return found, rows


def _attack(url: str, process: Served | None, wish: dict[str, Any]) -> Measured:
    assert process is not None
    seconds = min(wish["seconds"], 300.0)
    result = run_attack(process, clients=wish["attackers"], seconds=seconds, seed=wish["seed"])
    rows = [
        (
            f"{name}: alone → beside {result.clients} attackers",
            f"{result.alone.get(name, 'not asked')} → {found}",
            "< 100 ms",
        )
        for name, found in result.attacked.items()
    ]
    said = {status for statuses in result.answers.values() for status in statuses}
    count = sum(sum(statuses.values()) for statuses in result.answers.values())
    rows.append(("hostile requests, and their answers", f"{count}: {', '.join(sorted(said))}", "no 500"))
    return asdict(result) | {"worst_ms": result.worst_ms}, rows


OVERLOAD = 2.0
"""Times what the service can take."""


async def _overload(url: str, process: Served | None, wish: dict[str, Any]) -> Measured:
    await asyncio.sleep(WARM_UP_S)
    found = await run_overload(
        url,
        robots=wish["robots"],
        factor=OVERLOAD,
        seconds=wish["seconds"],
        writers=wish["writers"],
        seed=wish["seed"],
    )
    name = f"{OVERLOAD:g} times what it takes ({found.sustainable_per_s:g}/s), {wish['seconds']:g} s"
    said = (
        f"{found.accepted_per_s}/s of {found.asked_per_s}/s, {found.not_sent} not sent; "
        f"{sum(found.errors.values())} errors, {len(found.lost)} robots differ; sent late {found.sent_late}"
    )
    return asdict(found), [
        (f"{name}: accepted", str(found.accepted), "p99 < 1 s"),
        (f"{name}: refused (503)", f"{found.refused.count}; {found.refused}", "at once"),
        (f"{name}: achieved", said, "0, 0"),
        *(
            (f"{name}: {asked}", f"{took.count}; {took}", "< 100 ms")
            for asked, took in found.operator.items()
        ),
    ]


GROWTH_CHANGES = 1000


async def _growth(url: str, process: Served | None, wish: dict[str, Any]) -> Measured:
    assert process is not None
    robots = min(wish["robots"], 50)
    found = await run_growth(process, robots=robots, changes=GROWTH_CHANGES, seed=wish["seed"])
    tables = ", ".join(f"{name} {size:.0f}" for name, size in found.tables.items())
    shown = f"{found.bytes_a_change:.0f} bytes ({tables})"
    name = f"{found.changes} changes of {robots} robots, each diagnosed with something new: on the disk, each"
    hour = "one robot that reports the same 3,600 times, dated, with a lifetime and a key each"
    return asdict(found), [
        (name, shown, "< 1,000 bytes"),
        (hour, f"{found.bytes_an_hour:.0f} bytes", "0"),
    ]


STOP_ROBOTS = 4
"""Under repair at a time: each has a board of its own."""


async def measure_stop(arguments: list[str], wish: dict[str, Any]) -> Measured:
    """Measure the global stop on services of its own."""
    count = min(wish["robots"], STOP_ROBOTS)
    results = await run_stops(arguments, moments=wish["moments"], count=count, seed=wish["seed"])
    found: dict[str, Any] = {"errors": [error for result in results for error in result.errors]}
    rows = []
    for result in results:
        name = f"{result.way}, asked of {result.asked_of}"
        figures = found[name] = result.figures()
        for state, goal in (("idle", "< 0.1 s"), ("running", "< 1 s")):
            one = figures[state]
            what = "nothing was running" if state == "idle" else "an action was running"
            shown = "none"
            if one["count"]:
                shown = f"p50 {one['p50_ms']:.0f} · p90 {one['p90_ms']:.0f} · max {one['max_ms']:.0f} ms"
            rows.append((f"{name}: to the end of {one['count']} repairs while {what}", shown, goal))
        began = f"{figures['begun_after_request']} actions of {figures['repairs']} repairs"
        last = f"{began}, the last {figures['last_begun_ms']:.0f} ms after it; {len(result.late)} late"
        rows.append((f"{name}: what boards and programs began after it", last, "< 0.1 s"))
    return found, rows


Measure = Callable[[str, Served | None, dict[str, Any]], "Coroutine[Any, Any, Measured] | Measured"]
"""One that is no coroutine blocks, and not in a thread of its own: Ctrl-C breaks off the main thread only."""

MEASURES: dict[str, Measure] = {
    "single": _single,
    "fleet": _fleet,
    "memory": _memory,
    "posts": _posts,
    "ndjson": _ndjson,
    "stop-under-attack": _attack,
    "overload": _overload,
    "growth": _growth,
}

OWN = frozenset({"memory", "stop", "stop-under-attack", "growth"})
"""Parts that need a service of their own."""
