"""Which nodes run: by their tokens, and for those on this computer by their processes.

what is seen                                         the node is
its token is there                                   running
its token has gone: it was destroyed, it said        not running, at once
    goodbye, its connection is closed or its lease
    is over (10 s or more)
its process on this computer is stopped              not running, at once
we have no connection to anybody, or only just now   unknown: the tokens went with the network
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable

from robomend_client.bridges.processes import Process, has_open, is_ours
from robomend_client.bridges.ros2.base import LOOK_S
from robomend_client.bridges.zenoh.node import ZenohNode
from robomend_client.bridges.zenoh.session import Link


class Liveness:
    """Of all nodes of one domain."""

    def __init__(self, node: ZenohNode, settled_s: float) -> None:
        """`settled_s` after a connection was made, all tokens have come."""
        self._node = node
        self._settled_s = settled_s
        self._processes: dict[Link, Process | None] = {}
        self._before: dict[str, bool] = {}

    async def look(self) -> dict[str, bool] | None:
        """Return which nodes run now; None: nobody knows."""
        found = await self._look()
        if found is not None and any(self._before.get(node) and not runs for node, runs in found.items()):
            await asyncio.sleep(LOOK_S)  # a connection that ends takes the tokens along, a little before it
            found = await self._look()
        self._before = found or {}
        return found

    async def _look(self) -> dict[str, bool] | None:
        since_s = self._node.connected_s
        if since_s is None or time.monotonic() - since_s < self._settled_s:
            return None
        links = set(self._node.links)
        for link in self._processes.keys() - links:
            del self._processes[link]
        for link in links - self._processes.keys():
            self._processes[link] = await asyncio.to_thread(_process, link)
        works = {link.session: p.works() for link, p in self._processes.items() if p is not None}
        sessions = self._node.graph.sessions()
        return self._node.graph.nodes({s for s in sessions if not all(_of(works, s))})


def _process(link: Link) -> Process | None:
    """Return the process at the other end, where that is on this computer."""
    if not link.port or not is_ours(link.address):
        return None
    return has_open(lambda local, remote: (local, remote) == (link.port, link.own_port), ("tcp", "tcp6"))


def _of(works: dict[str, bool], session: str) -> Iterable[bool]:
    """Return what is known of a session, by its name in tokens: releases of 2024 leave out zeros."""
    for linked, runs in works.items():
        padded = linked.zfill(len(linked) + len(linked) % 2)
        short = "".join(f"{int(padded[n : n + 2], 16):x}" for n in range(0, len(padded), 2))
        if session in (linked, padded, short):
            yield runs
