"""The link against a real socket: the emulator in the same loop, or a server that behaves worse than it can.

Nothing here asserts how long something took; waits only have a generous end.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
import time
from collections.abc import AsyncIterator, Awaitable, Callable

import pytest
from tests.robomend_board.processes import running

from robomend.board.codec import (
    Acknowledge,
    ChannelLimits,
    ChannelReading,
    Measurements,
    Specification,
    encode,
)
from robomend.board.link import BoardLink, LinkState, Snapshot
from robomend.errors import BoardRefused, BoardTimeout, BoardUnreachable
from robomend_board.board import Board
from robomend_board.faults import parse_fault
from robomend_board.loads import default_rig
from robomend_board.server import Emulator

pytestmark = pytest.mark.anyio

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


async def fault(emulator: Emulator, name: str, **parameters: object) -> None:
    await emulator.set_fault(parse_fault({"fault": name, **parameters}, len(emulator.board.channels)))


def on(snapshot: Snapshot, channel: int) -> bool:
    assert snapshot.channels is not None
    return snapshot.channels[channel].on


def link_to(port: int, *, host: str = "127.0.0.1", **options: object) -> BoardLink:
    defaults: dict[str, object] = {"broadcast_hz": 100, "command_timeout_s": END_S, "backoff_s": (0.01, 0.05)}
    return BoardLink(host, port, **{**defaults, **options})  # type: ignore[arg-type]  # mixed kinds


@pytest.fixture(scope="module", params=[False, True], ids=["asyncio", "uvloop"])
def anyio_backend(request: pytest.FixtureRequest) -> tuple[str, dict[str, bool]]:
    """Both loops: the service runs on uvloop, tools and the emulator on asyncio's own."""
    return ("asyncio", {"use_uvloop": request.param})


# --- what works ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("channels", [8, 10])
async def test_measurements_come_with_as_many_channels_as_the_board_has(channels: int) -> None:
    async with emulated(channels) as emulator, link_to(emulator.port) as link:
        await until(lambda: link.snapshot.channels is not None)
        assert link.channels == channels
        assert link.state is LinkState.CONNECTED
        assert [reading.on for reading in link.snapshot.channels or ()] == [n == 2 for n in range(channels)]


async def test_switching_acts_and_shows_and_may_be_repeated() -> None:
    async with emulated() as emulator, link_to(emulator.port) as link:
        await link.switch(7, True)
        await link.switch(7, True)
        assert emulator.board.relays()[7]
        assert on(await link.request(), 7)
        await link.switch(7, False)
        assert not emulator.board.relays()[7]


async def test_commands_of_many_callers_are_queued_and_each_gets_its_answer() -> None:
    async with emulated() as emulator, link_to(emulator.port) as link:
        await asyncio.gather(*(link.switch(n, True) for n in range(10)))
        results = await asyncio.gather(
            link.switch(3, False), link.switch(12, True), link.switch(4, False), return_exceptions=True
        )
        assert results[0] is None
        assert isinstance(results[1], BoardRefused)
        assert results[2] is None
        assert emulator.board.relays() == tuple(n not in (3, 4) for n in range(10))


async def test_a_reader_that_lags_misses_the_oldest_and_gets_the_newest() -> None:
    async with emulated() as emulator, link_to(emulator.port) as link:
        await link.wait_connected(END_S)
        lagging, prompt = link.measurements(), link.measurements()
        await anext(lagging)
        for _ in range(100):
            await anext(prompt)
        await link.close()
        rest = [snapshot async for snapshot in lagging]
        assert 0 < len(rest) <= 64
        assert rest[-1].channels is None  # closing is unknown too


# --- what the board refuses ----------------------------------------------------------------------------


async def test_a_refusal_says_which_board_what_and_why() -> None:
    async with emulated() as emulator, link_to(emulator.port) as link:
        await fault(emulator, "stuck", channel=7)
        with pytest.raises(BoardRefused, match=r"127\.0\.0\.1:\d+ refused to switch channel 7 .*faulty"):
            await link.switch(7, True)
        with pytest.raises(BoardRefused, match="no such channel"):
            await link.switch(10, True)
        with pytest.raises(BoardRefused, match="no such channel"):
            await link.switch(1000, True)
        assert link.state is LinkState.CONNECTED


@pytest.mark.parametrize(
    ("host", "why"), [("127.0.0.1", "Connection refused"), ("no-such-host.invalid", "not known|resolution")]
)
async def test_why_nobody_is_reached_is_said_in_words(host: str, why: str) -> None:
    async with link_to(1, host=host, connect_timeout_s=END_S) as link:
        await until(lambda: link.state is LinkState.DISCONNECTED)
        assert re.search(why, link.reason)
        assert "Errno" not in link.reason
        with pytest.raises(BoardUnreachable, match=f"{host}:1"):
            await link.switch(7, True, timeout_s=0.3)
        with pytest.raises(BoardUnreachable):
            await link.wait_connected(0.05)
        assert link.snapshot.channels is None


# --- silence and loss ----------------------------------------------------------------------------------


async def test_silence_is_unknown_and_the_board_is_known_again_when_it_speaks() -> None:
    states: list[LinkState] = []
    async with emulated() as emulator, link_to(emulator.port, on_state=lambda s, _: states.append(s)) as link:
        await until(lambda: link.snapshot.channels is not None)
        emulator.line.mute = True
        await until(lambda: link.snapshot.channels is None)
        assert link.state is LinkState.SILENT
        assert "no measurements for 0.5 s" in link.snapshot.reason
        emulator.line.mute = False
        await until(lambda: link.snapshot.channels is not None)
        assert states == [LinkState.CONNECTED, LinkState.SILENT, LinkState.CONNECTED]


async def test_a_service_that_is_held_up_itself_takes_no_board_for_silent() -> None:
    states: list[LinkState] = []
    with running() as emulator:  # in another process
        async with link_to(emulator.port, on_state=lambda s, _: states.append(s)) as link:
            await until(lambda: link.snapshot.channels is not None)
            for _ in range(2):
                time.sleep(1.0)  # the loop is held for twice as long as a board may be silent
                await asyncio.sleep(0.05)  # and gets a moment
            assert states == [LinkState.CONNECTED]
            assert link.snapshot.channels is not None


async def test_a_lost_acknowledge_is_a_timeout_whose_outcome_the_measurements_show() -> None:
    async with emulated() as emulator, link_to(emulator.port) as link:
        await link.wait_connected(END_S)
        emulator.line.mute = True
        with pytest.raises(BoardTimeout, match="whether it acted is unknown"):
            await link.switch(7, True, timeout_s=0.1)
        assert link.snapshot.channels is None
        emulator.line.mute = False
        await until(lambda: link.snapshot.channels is not None)
        assert on(link.snapshot, 7)


async def test_a_late_acknowledge_is_never_taken_for_the_next_commands() -> None:
    async with emulated() as emulator, link_to(emulator.port) as link:
        await link.wait_connected(END_S)
        await fault(emulator, "stuck", channel=7)
        await fault(emulator, "late", delay_s=0.3)
        with pytest.raises(BoardTimeout):
            await link.switch(7, True, timeout_s=0.05)  # its refusal is on the way
        await link.switch(3, True)
        assert emulator.board.relays()[3]


async def test_a_cancelled_command_spoils_nothing_for_the_next() -> None:
    async with emulated() as emulator, link_to(emulator.port) as link:
        await link.wait_connected(END_S)
        await fault(emulator, "late", delay_s=60.0)
        task = asyncio.create_task(link.switch(7, True))
        await until(lambda: emulator.board.relays()[7])
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        await emulator.clear("all", None)
        with pytest.raises(BoardRefused):
            await link.switch(11, True)
        await link.switch(3, True)


async def test_a_connection_lost_in_mid_command_is_an_unknown_outcome() -> None:
    async with emulated() as emulator, link_to(emulator.port) as link:
        await link.wait_connected(END_S)
        emulator.line.mute = True
        task = asyncio.create_task(link.switch(7, True))
        await until(lambda: emulator.board.relays()[7])
        await fault(emulator, "drop")
        with pytest.raises(BoardTimeout, match="whether the board acted is unknown"):
            await task


@pytest.mark.parametrize("size", [1, 3, 50])
async def test_split_frames_are_understood(size: int) -> None:
    async with emulated() as emulator, link_to(emulator.port, broadcast_hz=5) as link:
        await fault(emulator, "split", size=size)
        for channel in range(5):
            await link.switch(channel, True)
        assert [r.on for r in (await link.request()).channels or ()] == [n < 5 for n in range(10)]


async def test_garbage_costs_the_connection_and_not_the_link() -> None:
    states: list[tuple[LinkState, str]] = []
    async with (
        emulated() as emulator,
        link_to(emulator.port, on_state=lambda s, r: states.append((s, r))) as link,
    ):
        await link.wait_connected(END_S)
        await fault(emulator, "garbage")
        await until(lambda: any(s is LinkState.DISCONNECTED and "not 0x02" in r for s, r in states))
        await link.switch(7, True)
        assert emulator.board.relays()[7]


# --- what is no board, or breaks the protocol -----------------------------------------------------------


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


async def test_a_server_that_says_nothing_is_given_up_in_time() -> None:
    async def silent(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read()

    async with badly_behaved(silent) as port, link_to(port, connect_timeout_s=0.1) as link:
        await until(lambda: "is it a power board?" in link.reason)


@pytest.mark.parametrize(
    "greeting",
    [
        b"HTTP/1.1 400 Bad Request\r\n\r\n",
        MEASUREMENTS,
        encode(Acknowledge(0)),
        SPECIFICATION + SPECIFICATION,
        SPECIFICATION + encode(Measurements((ChannelReading(False, 0.0, 0.0),) * 10)),
        bytes.fromhex("02 63 00 00"),
    ],
)
async def test_whoever_breaks_the_protocol_is_dropped_with_the_reason(greeting: bytes) -> None:
    async def greet(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(greeting)
        await reader.read()

    async with badly_behaved(greet) as port, link_to(port) as link:
        await until(lambda: link.state is LinkState.DISCONNECTED)
        assert link.reason != "not yet connected"
        with pytest.raises(BoardUnreachable):
            await link.switch(1, True, timeout_s=0.05)


# --- the end -------------------------------------------------------------------------------------------


async def test_closing_ends_every_wait_and_may_be_repeated() -> None:
    async with emulated() as emulator:
        link = link_to(emulator.port)
        link.start()
        await link.wait_connected(END_S)
        emulator.line.mute = True
        waiting = asyncio.create_task(link.switch(7, True))
        queued = asyncio.create_task(link.switch(8, True))
        reading = asyncio.create_task(_read_all(link))
        await until(lambda: emulator.board.relays()[7])
        await link.close()
        await link.close()
        with pytest.raises(BoardTimeout):
            await waiting
        with pytest.raises(BoardUnreachable, match="closed"):
            await queued
        assert (await reading)[-1].channels is None
        assert link.state is LinkState.CLOSED
        await until(lambda: not emulator.clients)
        with pytest.raises(BoardUnreachable, match="closed"):
            await link.switch(7, False)
        assert await _read_all(link) == []


async def _read_all(link: BoardLink) -> list[Snapshot]:
    return [snapshot async for snapshot in link.measurements()]


@pytest.mark.parametrize(("port", "hz"), [(5000, 0), (5000, 256), (0, 5), (70000, 5)])
def test_options_that_no_board_takes_are_refused_at_once(port: int, hz: int) -> None:
    with pytest.raises(ValueError, match=r"broadcast_hz|port"):
        BoardLink("127.0.0.1", port, broadcast_hz=hz)
