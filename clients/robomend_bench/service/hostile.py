"""What others suffer from clients that are slow, half gone or only listening.

    the same open-loop load   alone ──► with the crowd ──► alone again
                                             │
         slow readers     an event stream of everything, read a byte a second, the smallest buffer
         slow writers     a body of a kilobyte, sent a byte a second
         half-open        a connection with half a request line, and silence
         idle streams     an event stream on which nothing happens

The third run tells a service that suffers from one that was slow that moment for other reasons.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass

from robomend_bench.service.load import FleetResult, SimulatedRobot, prepare, run_fleet
from robomend_bench.service.process import Served
from robomend_bench.service.wire import EventStream, address, follow, request


@dataclass(frozen=True, slots=True)
class Crowd:
    """How many of each kind."""

    slow_readers: int = 50
    slow_writers: int = 50
    half_open: int = 200
    idle_streams: int = 500


@dataclass(frozen=True, slots=True)
class HostileResult:
    """The load before, with and after the crowd."""

    crowd: Crowd
    alone: FleetResult
    crowded: FleetResult
    after: FleetResult

    @property
    def ratio(self) -> float:
        """p99 until the diagnosis with the crowd, over the worse of the two runs without it."""
        without = max(self.alone.diagnosed.p99_ms, self.after.diagnosed.p99_ms)
        return round(self.crowded.diagnosed.p99_ms / without, 2)


@asynccontextmanager
async def crowding(url: str, crowd: Crowd, idle_robot: str) -> AsyncIterator[None]:
    """Keep the crowd there while the block runs."""
    tasks = [
        *(asyncio.create_task(_slow_reader(url)) for _ in range(crowd.slow_readers)),
        *(asyncio.create_task(_slow_writer(url, idle_robot)) for _ in range(crowd.slow_writers)),
        *(asyncio.create_task(_half_open(url)) for _ in range(crowd.half_open)),
    ]
    streams: list[EventStream] = []
    try:
        for _ in range(crowd.idle_streams):
            streams.append(await follow(url, lambda _: None, f"/api/v1/robots/{idle_robot}/events"))
        await asyncio.sleep(1.0)
        yield
    finally:
        for stream in streams:
            stream.close()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _connection(url: str) -> socket.socket:
    client = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)  # the kernel's least
    client.setblocking(False)
    await asyncio.get_running_loop().sock_connect(client, address(url))
    return client


async def _slow_reader(url: str) -> None:
    loop = asyncio.get_running_loop()
    while True:
        with contextlib.suppress(OSError), await _connection(url) as client:
            await loop.sock_sendall(client, request("GET", "/api/v1/events"))
            while await loop.sock_recv(client, 1):
                await asyncio.sleep(1.0)
        await asyncio.sleep(1.0)  # it was thrown out, and comes back


async def _slow_writer(url: str, robot: str) -> None:
    loop = asyncio.get_running_loop()
    wire = request("POST", f"/api/v1/robots/{robot}/observations", b" " * 1000)
    head, letters = wire[:-1000], wire[-1000:]
    while True:
        with contextlib.suppress(OSError), await _connection(url) as client:
            await loop.sock_sendall(client, head)
            for position in range(len(letters)):
                await loop.sock_sendall(client, letters[position : position + 1])
                await asyncio.sleep(1.0)
        await asyncio.sleep(1.0)


async def _half_open(url: str) -> None:
    loop = asyncio.get_running_loop()
    while True:
        with contextlib.suppress(OSError), await _connection(url) as client:
            await loop.sock_sendall(client, b"POST /api/v1/robots/")
            await loop.sock_recv(client, 1)  # nothing comes, until the service has had enough
        await asyncio.sleep(1.0)


async def run_hostile(
    url: str, *, robots: int, seconds: float, crowd: Crowd | None = None, served: Served | None = None
) -> HostileResult:
    """Measure the load alone, with the crowd, and alone again."""
    there = crowd or Crowd()
    fleet = [SimulatedRobot(f"bench-bystander-{number}", 1, faults=3) for number in range(robots)]
    idle = SimulatedRobot("bench-idle", 1, faults=1)
    await prepare(url, [*fleet, idle])

    async def load(seed: int) -> FleetResult:
        return await run_fleet(url, fleet, rate_hz=1.0, seconds=seconds, seed=seed, served=served)

    alone = await load(1)
    async with crowding(url, there, idle.name):
        crowded = await load(2)
    return HostileResult(there, alone, crowded, await load(3))
