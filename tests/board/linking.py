"""A link for tests, to the emulator in the same loop or to a server that behaves worse than it can."""

from __future__ import annotations

import asyncio
import contextlib
import queue
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator

from robomend.board.codec import (
    ChannelLimits,
    ChannelReading,
    Measurements,
    Specification,
    encode,
)
from robomend.board.link import BoardLink, Snapshot
from robomend_board.board import Board
from robomend_board.faults import parse_fault
from robomend_board.loads import default_rig
from robomend_board.server import Emulator

END_S = 60.0


async def until(condition: Callable[[], bool]) -> None:
    """Wait until it is so; the test fails if it never is."""
    async with asyncio.timeout(END_S):
        while not condition():
            await asyncio.sleep(0.005)


@contextlib.asynccontextmanager
async def emulated(channels: int = 10, on: tuple[int, ...] = (2,)) -> AsyncIterator[Emulator]:
    emulator = Emulator(Board(default_rig(channels), on))
    await emulator.listen("127.0.0.1", 0)
    try:
        yield emulator
    finally:
        await emulator.close()


@contextlib.contextmanager
def emulated_elsewhere() -> Iterator[int]:
    """A board that goes on while this loop is held up; its port."""
    ports: queue.Queue[int] = queue.Queue()
    over = threading.Event()

    async def serve() -> None:
        async with emulated() as emulator:
            ports.put(emulator.port)
            await asyncio.to_thread(over.wait, END_S)

    thread = threading.Thread(target=lambda: asyncio.run(serve()), daemon=True)
    thread.start()
    try:
        yield ports.get(timeout=END_S)
    finally:
        over.set()
        thread.join(END_S)


async def fault(emulator: Emulator, name: str, **parameters: object) -> None:
    await emulator.set_fault(parse_fault({"fault": name, **parameters}, len(emulator.board.channels)))


def on(snapshot: Snapshot, channel: int) -> bool:
    assert snapshot.channels is not None
    return snapshot.channels[channel].on


def link_to(port: int, *, host: str = "127.0.0.1", **options: object) -> BoardLink:
    defaults: dict[str, object] = {"broadcast_hz": 100, "command_timeout_s": END_S, "backoff_s": (0.01, 0.05)}
    return BoardLink(host, port, **{**defaults, **options})  # type: ignore[arg-type]  # mixed kinds


Handler = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


@contextlib.asynccontextmanager
async def badly_behaved(handler: Handler) -> AsyncIterator[int]:
    """A server that does with each connection what `handler` does."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError, asyncio.IncompleteReadError):
            await handler(reader, writer)
        writer.transport.abort()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()
        await asyncio.sleep(0.01)  # connections that are being closed end


SPECIFICATION = encode(Specification((ChannelLimits(10.0, 24.0),) * 8))
MEASUREMENTS = encode(Measurements((ChannelReading(False, 0.0, 0.0),) * 8))
