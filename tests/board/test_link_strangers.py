"""The link against what is no board, or breaks the protocol; and what its log says of it.

Nothing here asserts how long something took; waits only have a generous end.
"""

from __future__ import annotations

import asyncio
import socket

import pytest
from tests.board.linking import (
    MEASUREMENTS,
    SPECIFICATION,
    badly_behaved,
    link_to,
    until,
)

from robomend.board.codec import (
    Acknowledge,
    ChannelReading,
    Measurements,
    Specification,
    encode,
)
from robomend.board.link import LinkState
from robomend.errors import BoardUnreachable

pytestmark = pytest.mark.anyio


@pytest.fixture(scope="module", params=[False, True], ids=["asyncio", "uvloop"])
def anyio_backend(request: pytest.FixtureRequest) -> tuple[str, dict[str, bool]]:
    """Both loops: the service runs on uvloop, tools and the emulator on asyncio's own."""
    return ("asyncio", {"use_uvloop": request.param})


def a_free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


async def test_a_board_that_is_not_there_is_named_with_the_reason() -> None:
    port = a_free_port()
    async with link_to(port) as link:
        with pytest.raises(BoardUnreachable, match=f"127.0.0.1:{port}.*(refused|Connect)"):
            await link.switch(7, True, timeout_s=0.3)
        with pytest.raises(BoardUnreachable):
            await link.wait_connected(0.05)
        assert link.snapshot.channels is None


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
        encode(Specification(())),
        SPECIFICATION + SPECIFICATION,
        SPECIFICATION + encode(Measurements((ChannelReading(False, 0.0, 0.0),) * 10)),
        bytes.fromhex("02 00 FF FF"),
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


# --- what the log says ---------------------------------------------------------------------------------
