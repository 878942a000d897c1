"""The parts of `robomend-bench service`: what each measures, and the rows of the table that it gives."""

from __future__ import annotations

import asyncio
import statistics
import tempfile
from collections.abc import Callable, Coroutine
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from robomend_bench.service.attack import make_keys, run_attack
from robomend_bench.service.beside_bare import BesideBare, run_beside_bare
from robomend_bench.service.durable import run_ndjson, run_posts
from robomend_bench.service.fleet import FleetResult, prepare, run_fleet, run_single
from robomend_bench.service.floods import drip, run_floods
from robomend_bench.service.growth import run_growth
from robomend_bench.service.hostile import run_hostile
from robomend_bench.service.measure import children, memory_mb
from robomend_bench.service.overload import run_overload
from robomend_bench.service.pages import run_pages
from robomend_bench.service.process import Served, start
from robomend_bench.service.robots import SimulatedRobot
from robomend_bench.service.stops import run_stops

Row = tuple[str, str, str]
"""What was measured, what came out, the goal."""

Measured = tuple[dict[str, Any], list[Row]]

WARM_UP_S = 3.0
"""The service's workers warm up beside it; and what it takes at rest is what it takes then."""


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
    if process is None:
        raise click.UsageError("part memory needs a service of its own; leave out --url")
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


async def _hostile(url: str, process: Served | None, wish: dict[str, Any]) -> Measured:
    robots = min(wish["robots"], 200)
    seconds = min(wish["seconds"], 60.0)
    result = await run_hostile(url, robots=robots, seconds=seconds, served=process)
    crowd = result.crowd
    name = (
        f"{robots} robots beside {crowd.slow_readers} slow readers, {crowd.slow_writers} slow writers, "
        f"{crowd.half_open} half-open connections, {crowd.idle_streams} idle streams"
    )
    runs = (result.alone, result.crowded, result.after)
    shown = " → ".join(f"{run.diagnosed.p99_ms:.1f}" for run in runs)
    errors: dict[str, int] = {}
    for run in runs:
        errors.update(run.errors)
    found = asdict(result) | {"ratio": result.ratio, "errors": errors}
    return found, [(name, f"p99 {shown} ms: ×{result.ratio}", "within ×2")]


async def _pages(url: str, process: Served | None, wish: dict[str, Any]) -> Measured:
    if process is None:
        raise click.UsageError("part pages needs a service of its own; leave out --url")
    robots, seconds = min(wish["robots"], 200), min(wish["seconds"], 60.0)
    result = await run_pages(url, process, robots=robots, pages=wish["pages"], seconds=seconds)
    runs = (result.alone, result.watched, result.after)
    p99 = " → ".join(f"{run.diagnosed.p99_ms:.1f}" for run in runs)
    cores = " → ".join(str(run.service_cpu) for run in runs)
    errors: dict[str, int] = {}
    for run in runs:
        errors.update(run.errors)
    idle = f"{result.idle_alone:.1%} → {result.idle_open:.1%} of a core"
    name = f"{robots} robots, a change a second each, beside {result.pages} open pages"
    fetched = f"{result.fetched_per_s}/s fetched, {result.kb_per_s_a_page} kB/s a page"
    return asdict(result) | {"ratio": result.ratio, "errors": errors}, [
        (f"nothing changes: without → with {result.pages} open pages", idle, "< 20% of a core"),
        (name, f"p99 {p99} ms: ×{result.ratio}", "within ×1.2"),
        (f"{name}: costs", f"service {cores} cores; {fetched}; load {result.after.load}", ""),
    ]


def _attack(url: str, process: Served | None, wish: dict[str, Any]) -> Measured:
    if process is None:
        raise click.UsageError("part stop-under-attack needs a service of its own; leave out --url")
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
    held = result.held
    hold = (
        f"{held['over_5_ms']:.0f} of {held['ticks']:.0f} ticks late by over 5 ms, "
        f"{held['over_50_ms']:.0f} by over 50 ms, at most by {held['loop_worst_s'] * 1000:.0f} ms"
    )
    rows.append(("event loop", hold, ""))
    said = {status for statuses in result.answers.values() for status in statuses}
    count = sum(sum(statuses.values()) for statuses in result.answers.values())
    rows.append(("hostile requests, and their answers", f"{count}: {', '.join(sorted(said))}", "no 500"))
    return asdict(result) | {"worst_ms": result.worst_ms}, rows


def _strangers(url: str, process: Served | None, wish: dict[str, Any]) -> Measured:
    if process is None:
        raise click.UsageError("part strangers needs a service of its own; leave out --url")
    make_keys(process)
    found = run_floods(process, min(wish["seconds"], 6.0))
    rows = [
        (
            f"one connection without a key: {name}",
            f"{flood.grown_mb} MB more, {flood.sent_mb:.0f} MB sent; it lived {flood.longest_s} s",
            "< 1 MB",
        )
        for name, flood in found.items()
    ]
    lived_s = drip(url, 1.0, 60.0)
    rows.append(("one connection without a key: a byte a second of a body", f"it lived {lived_s:.0f} s", ""))
    return {name: asdict(flood) for name, flood in found.items()} | {"drip_s": lived_s}, rows


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
    if process is None or not (process.data / "robomend.db").exists():
        raise click.UsageError(
            "part growth needs a service of its own on SQLite; leave out --url, --database"
        )
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


BARE_TURNS = 7
BARE_PER_S = 150.0
"""Changes: few enough for a machine that others use, where more would be refused."""


async def _beside_bare(url: str, process: Served | None, wish: dict[str, Any]) -> Measured:
    robots = min(wish["robots"], 100)
    found = await _in_turns(process, wish, "beside-bare", robots, BARE_PER_S / robots)
    return asdict(found) | {"ratio": found.ratio}, [_processor_beside_bare(found)]


async def _fleet_beside_bare(url: str, process: Served | None, wish: dict[str, Any]) -> Measured:
    found = await _in_turns(process, wish, "fleet-beside-bare", wish["robots"], wish["rate"])
    name = f"{wish['robots']} robots, {found.asked_per_s:g} changes/s, to the acknowledgement"
    rows = [_processor_beside_bare(found)]
    for what, goal in (("p50_ms", "×1.5"), ("p99_ms", "×1.3")):
        service, bare = (
            [getattr(turn, what) for turn in turns] for turns in (found.service_answers, found.bare_answers)
        )
        ratio = statistics.median(s / b for s, b in zip(service, bare, strict=True))
        middle = f"{statistics.median(service):.1f} and {statistics.median(bare):.1f} ms: ×{ratio:.2f}"
        rows.append((f"{name}, {what[:3]}: the service, and a bare handler", middle, goal))
    return asdict(found), rows


async def _in_turns(
    process: Served | None, wish: dict[str, Any], part: str, robots: int, rate_hz: float
) -> BesideBare:
    if process is None:
        raise click.UsageError(f"part {part} needs a service of its own; leave out --url")
    await asyncio.sleep(WARM_UP_S)
    found = await run_beside_bare(
        process,
        robots=robots,
        rate_hz=rate_hz,
        seconds=min(wish["seconds"], 60.0) / BARE_TURNS,
        turns=BARE_TURNS,
        seed=wish["seed"],
        database=wish["database"] or "",
    )
    if not all(found.bare_ms):
        raise click.UsageError(f"part {part} needs more --seconds: a turn took no tick of the processor")
    return found


def _processor_beside_bare(found: BesideBare) -> tuple[str, str, str]:
    service, bare = (statistics.median(times) for times in (found.service_ms, found.bare_ms))
    shown = f"{service:.2f} and {bare:.2f} ms: ×{found.ratio:.2f} ({found.errors} errors)"
    name = f"processor time a change at {found.asked_per_s:g}/s: the service, and a bare handler"
    return name, shown, "×1.5; PostgreSQL ×2"


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
    "hostile": _hostile,
    "pages": _pages,
    "stop-under-attack": _attack,
    "strangers": _strangers,
    "overload": _overload,
    "growth": _growth,
    "beside-bare": _beside_bare,
    "fleet-beside-bare": _fleet_beside_bare,
}
