"""What open pages cost the service, while nothing changes and while a fleet reports.

    idle     the service's processor time, without pages ──► with all of them open
    loaded   the same open-loop load   alone ──► with the pages ──► alone again

An open page is what a browser's is to the service: the whole of it once, then an event stream and all of its
parts again, and with an event that concerns it the parts that differ, fetched at once after a quiet while and
then so that they come to `BYTES_PER_S` on average, or as much later as the service says
(service/robomend/web/static/parts.js). All are open before anything is measured. Every second page is the
list of all robots, the others are of one robot each. No browser takes part: with fifty of them on one
machine, the browsers would be measured.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass

from robomend_bench.service.fleet import FleetResult, prepare, run_fleet
from robomend_bench.service.measure import cpu_s
from robomend_bench.service.process import Served
from robomend_bench.service.robots import SimulatedRobot
from robomend_bench.service.wire import ServiceGone, connect, follow, request

BYTES_PER_S = 4800
LEAST_S = 0.2
WARM_UP_S = 3.0

LIST = ("/", "fleet", "kind=diagnosis&kind=repair&kind=robot&kind=board&kind=stop")
"""Address, the parts that a diagnosis concerns, and which events it follows."""

ROBOT_PARTS = "state,repair,diagnosis,graph,obs,past"


@dataclass(frozen=True, slots=True)
class PagesResult:
    """What came of it."""

    pages: int
    idle_alone: float  # of a core
    idle_open: float
    alone: FleetResult
    watched: FleetResult
    after: FleetResult
    fetched_per_s: float  # by all pages
    kb_per_s_a_page: float

    @property
    def ratio(self) -> float:
        """p99 until the diagnosis with the pages, over the worse of the two runs without them."""
        without = max(self.alone.diagnosed.p99_ms, self.after.diagnosed.p99_ms)
        return round(self.watched.diagnosed.p99_ms / without, 2)


@dataclass
class Fetched:
    """What the pages fetched so far."""

    times: int = 0
    bytes: int = 0


@asynccontextmanager
async def open_pages(
    url: str, robots: list[SimulatedRobot], count: int, fetched: Fetched
) -> AsyncIterator[None]:
    """Keep so many pages open while the block runs."""
    async with AsyncExitStack() as stack:
        for number in range(count):
            name = robots[number % len(robots)].name
            one = (f"/ui/robots/{name}", ROBOT_PARTS, f"about={name}")
            await stack.enter_async_context(_open_page(url, *(LIST if number % 2 == 0 else one), fetched))
        yield


@asynccontextmanager
async def _open_page(url: str, path: str, parts: str, follows: str, fetched: Fetched) -> AsyncIterator[None]:
    changed = asyncio.Event()

    def event(frame: bytes) -> None:
        if b"event: ping" not in frame:
            changed.set()

    connection = await connect(url)
    status, _ = await connection.ask(request("GET", path, accept_encoding="gzip"))
    if status != 200:
        raise RuntimeError(f"GET {path}: {status}")

    async def fetch() -> None:
        nonlocal connection
        wire = request("GET", path, robomend_parts=parts, accept_encoding="gzip")
        changed.set()  # as a browser does when its stream stands
        try:
            while True:
                await changed.wait()
                changed.clear()
                try:
                    status, body = await connection.ask(wire)
                except ServiceGone:  # it closes what is quiet for a while, as for a browser
                    connection = await connect(url)
                    changed.set()
                    continue
                if status != 200:
                    raise RuntimeError(f"GET {path}: {status}")
                fetched.times += 1
                fetched.bytes += len(body)
                told_s = float(connection.headers.get(b"robomend-again-ms", 0)) / 1000
                await asyncio.sleep(max(LEAST_S, told_s, len(body) / BYTES_PER_S))
        finally:
            connection.close()

    stream = await follow(url, event, f"/api/v1/events?brief=true&{follows}")
    fetching = asyncio.create_task(fetch())
    try:
        yield
        if fetching.done():
            fetching.result()  # raises what went wrong
    finally:
        stream.close()
        fetching.cancel()
        await asyncio.gather(fetching, return_exceptions=True)


async def run_pages(url: str, served: Served, *, robots: int, pages: int, seconds: float) -> PagesResult:
    """Measure the service alone and with pages, idle and under load."""
    # Robots of its own for each run: what one run was refused would be missed in the next.
    fleets = [
        [SimulatedRobot(f"bench-watched-{run}-{number}", run, faults=3) for number in range(robots)]
        for run in (1, 2, 3)
    ]
    for fleet in fleets:
        await prepare(url, fleet)
    fetched = Fetched()
    await asyncio.sleep(WARM_UP_S)

    async def idle() -> float:
        before = cpu_s(served.pid)
        await asyncio.sleep(seconds)  # that nothing happens is what is measured
        return round((cpu_s(served.pid) - before) / seconds, 3)

    async def load(run: int) -> FleetResult:
        return await run_fleet(url, fleets[run - 1], rate_hz=1.0, seconds=seconds, seed=run, served=served)

    idle_alone = await idle()
    alone = await load(1)
    async with open_pages(url, fleets[1], pages, fetched):
        await asyncio.sleep(WARM_UP_S)
        idle_open = await idle()
        times, size = fetched.times, fetched.bytes
        watched = await load(2)
        times, size = fetched.times - times, fetched.bytes - size
    return PagesResult(
        pages,
        idle_alone,
        idle_open,
        alone,
        watched,
        await load(3),
        round(times / seconds, 1),
        round(size / 1000 / seconds / pages, 2),
    )
