"""The master's state, asked for again and again: what changes in it is seen."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from robomend_client.bridges.ros1.master import Master
from robomend_client.bridges.ros1.xmlrpc import Garbage, XmlRpcServer


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
