"""Calls of the master and of nodes: what an error means, and which answers are read."""

from __future__ import annotations

import asyncio
import errno
import os
import socket
from typing import Any

import pytest

from robomend_client.bridges.ros1.master import Master
from robomend_client.bridges.ros1.xmlrpc import (
    Garbage,
    NobodyListens,
    OutOfReach,
    PeerError,
    XmlRpcServer,
    unreachable,
)


def connecting(*numbers: int) -> OSError:
    """Return what asyncio raises: of several addresses one text."""
    errors = [OSError(number, f"Connect call failed: {os.strerror(number)}") for number in numbers]
    return errors[0] if len(errors) == 1 else OSError(f"Multiple exceptions: {', '.join(map(str, errors))}")


@pytest.mark.parametrize(
    ("error", "means"),
    [
        (connecting(errno.ECONNREFUSED), NobodyListens),
        (connecting(errno.ECONNRESET), NobodyListens),  # it was killed, and its socket was still open
        (connecting(errno.ECONNREFUSED, errno.ECONNRESET), NobodyListens),
        (connecting(errno.ECONNREFUSED, errno.EHOSTUNREACH), OutOfReach),
        (connecting(errno.EHOSTUNREACH), OutOfReach),
        (socket.gaierror(socket.EAI_NONAME, "Name or service not known"), OutOfReach),
    ],
)
def test_who_refuses_or_hangs_up_does_not_run_and_of_who_is_out_of_reach_nothing_is_known(
    error: OSError, means: type[PeerError]
) -> None:
    assert type(unreachable("robot", 1, error)) is means


def test_a_state_that_has_not_changed_is_not_read_anew_and_one_that_has_is() -> None:
    state: list[Any] = [[["/scan", ["/laser"]]], [], []]

    async def test() -> None:
        server = XmlRpcServer(lambda method, _: [1, method, state], lambda *_: None)
        await server.open("127.0.0.1")
        master = Master(f"http://127.0.0.1:{server.port}/", "/me")
        first = await master.graph(types=False)
        assert first.nodes == {"/laser"}
        assert await master.graph(types=False) is first
        state[1].append(["/scan", ["/mapping"]])
        assert (await master.graph(types=False)).nodes == {"/laser", "/mapping"}
        state[0] = 7
        for _ in range(2):  # one that cannot be read is not taken for the one before
            with pytest.raises(Garbage, match="state cannot be read"):
                await master.graph(types=False)
        await server.close()

    asyncio.run(test())
