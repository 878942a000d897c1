"""What a change costs to keep, and an hour without one: the SQLite file before and after, table by table."""

from __future__ import annotations

import json
import sqlite3
import time
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from robomend_bench.service.fleet import prepare, run_fleet
from robomend_bench.service.process import Served
from robomend_bench.service.robots import SimulatedRobot
from robomend_bench.service.wire import connect, request

HOUR = 3600
"""Reports of a robot that says the same every second."""

CHANGES_A_SECOND = 50.0
"""Few enough for a busy machine: what counts is the file, not the time."""


@dataclass(frozen=True, slots=True)
class Growth:
    """Bytes of the file."""

    robots: int
    changes: int
    bytes_a_change: float
    bytes_an_hour: float  # of one robot that reports the same every second
    tables: dict[str, float]  # a change, with their indexes; where SQLite tells it
    errors: dict[str, int]  # changes that were not accepted
    lost: tuple[str, ...]


async def run_growth(served: Served, *, robots: int, changes: int, seed: int, repeats: int = HOUR) -> Growth:
    """Let robots report so many changes in all, each diagnosed with something new; then what is known."""
    path = served.data / "robomend.db"
    fleet = [SimulatedRobot(f"r{n}", seed, faults=3) for n in range(robots)]
    await prepare(served.url, fleet)
    before, tables_before, rows_before = _sizes(path)
    rate_hz = CHANGES_A_SECOND / robots
    run = await run_fleet(served.url, fleet, rate_hz=rate_hz, seconds=changes / CHANGES_A_SECOND, seed=seed)
    after, tables, rows = _sizes(path)
    count = max(1, rows - rows_before)
    unchanged = await _unchanged(served, fleet, repeats)
    grown = {name: (size - tables_before.get(name, 0)) / count for name, size in tables.items()}
    return Growth(
        robots,
        count,
        round((after - before) / count, 1),
        unchanged,
        {name: round(size, 1) for name, size in sorted(grown.items()) if size > 0},
        run.errors,
        run.lost,
    )


async def _unchanged(served: Served, fleet: list[SimulatedRobot], repeats: int) -> float:
    """Report what is known, as fast as it goes, as an agent would once a second: dated, with a lifetime and a
    key of its own. Return the bytes by which the file has grown, for an hour of one robot.
    """
    path, connection, before = served.data / "robomend.db", await connect(served.url), 0
    for number in range(-len(fleet), repeats):
        robot = fleet[number % len(fleet)]
        told = {"observations": sorted(robot.acknowledged()), "time": time.time_ns(), "lifetime_s": 3600}
        wire = request("POST", robot.path, json.dumps(told).encode(), Idempotency_Key=f"hour-{number}")
        status, _ = await connection.ask(wire)
        if status != 200:
            raise RuntimeError(f"an unchanged batch was answered {status}")
        if number == -1:  # each has a lifetime now
            before, _, _ = _sizes(path)
    connection.close()
    after, _, _ = _sizes(path)
    return (after - before) * HOUR / repeats


def _sizes(path: Path) -> tuple[int, dict[str, int], int]:
    """Return the bytes of the file after a checkpoint, of its tables, and how many batches it has."""
    with closing(sqlite3.connect(path, timeout=30.0)) as database:
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        [pages] = database.execute("PRAGMA page_count").fetchone()
        [size] = database.execute("PRAGMA page_size").fetchone()
        [batches] = database.execute("SELECT count(*) FROM events WHERE batch IS NOT NULL").fetchone()
        of_index = dict(database.execute("SELECT name, tbl_name FROM sqlite_master"))
        tables: dict[str, int] = {}
        try:
            parts = database.execute("SELECT name, sum(pgsize) FROM dbstat GROUP BY name").fetchall()
        except sqlite3.OperationalError:  # a SQLite that was built without this table
            parts = []
        for name, taken in parts:
            table = of_index.get(name, name)
            tables[table] = tables.get(table, 0) + taken
        return pages * size, tables, batches
