"""Clients that are slow, half gone or only listening, beside others.

slow readers     an event stream of everything, read a byte a second, the smallest buffer
slow writers     a body of a kilobyte, sent a byte a second
half-open        a connection with half a request line, and silence
idle streams     an event stream on which nothing happens
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from robomend_bench.service.wire import EventStream, address, follow, request


@asynccontextmanager
async def crowding(url: str, idle_robot: str) -> AsyncIterator[None]:
    """Keep the crowd there while the block runs."""
    tasks = [
        *(asyncio.create_task(_slow_reader(url)) for _ in range(10)),
        *(asyncio.create_task(_slow_writer(url, idle_robot)) for _ in range(10)),
        *(asyncio.create_task(_half_open(url)) for _ in range(20)),
    ]
    streams: list[EventStream] = []
    try:
        for _ in range(50):
            streams.append(await follow(url, lambda _: None, f"/api/v1/robots/{idle_robot}/events"))
        await asyncio.sleep(1.0)  # until all of them are there
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
                await asyncio.sleep(1.0)  # that is what slow means
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
                await asyncio.sleep(1.0)  # that is what slow means
        await asyncio.sleep(1.0)  # it was thrown out, and comes back


async def _half_open(url: str) -> None:
    loop = asyncio.get_running_loop()
    while True:
        with contextlib.suppress(OSError), await _connection(url) as client:
            await loop.sock_sendall(client, b"POST /api/v1/robots/")
            await loop.sock_recv(client, 1)  # nothing comes, until the service has had enough
        await asyncio.sleep(1.0)  # it was thrown out, and comes back
