"""Which nodes run: by their tokens, and for those on this computer by their processes.

what is seen                                         the node is
its token is there                                   running
its token has gone: it was destroyed, it said        not running, at once
    goodbye, its connection is closed or its lease
    is over (10 s or more)
its process on this computer is stopped              not running, at once
its token has gone with the router that it was       unknown: the network may have split
    behind, and that does not answer any more
we have no connection to anybody, or only just now   unknown: the tokens went with the network
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable, Mapping
from typing import TypeVar

from robomend_client.bridges.processes import Process, has_open, is_ours
from robomend_client.bridges.ros2.base import LOOK_S
from robomend_client.bridges.zenoh.node import ZenohNode
from robomend_client.bridges.zenoh.session import Link, ZenohSession

ASK_S = 5.0
"""How often routers are asked who is behind them."""

MOST_SESSIONS = 65536
Known = TypeVar("Known")


class Liveness:
    """Of all nodes of one domain."""

    def __init__(self, node: ZenohNode, session: ZenohSession, settled_s: float) -> None:
        """`settled_s` after a connection was made, all tokens have come."""
        self._node = node
        self._session = session
        self._behind: dict[str, str] = {}  # session -> the router that it is connected to
        self._routers: frozenset[str] = frozenset()  # that answer
        self._asked_s = float("-inf")
        self._near: dict[str, bool] = {}  # sessions of this computer: no network splits them off
        self._silent: set[str] = set()  # routers that were told of
        self._back: set[str] = set()  # those of them that answer again
        self._settled_s = settled_s
        self._processes: dict[Link, Process | None] = {}
        self._before: dict[str, bool] = {}

    async def look(self) -> dict[str, bool | None] | None:
        """Return which nodes run now, None where that is unknown; None: nobody knows."""
        found = await self._look()
        if found is not None and any(self._before.get(node) and not runs for node, runs in found.items()):
            await asyncio.sleep(LOOK_S)  # a connection that ends takes the tokens along, a little before it
            found = await self._look()
        ended = found is not None and any(self._before.get(node) and not runs for node, runs in found.items())
        self._before = found or {}
        if found is None:
            return None
        if ended or time.monotonic() - self._asked_s >= ASK_S:
            await self._ask_routers()
        return self._without_routers(found)

    async def _ask_routers(self) -> None:
        told = await asyncio.to_thread(self._session.routers)
        self._asked_s = time.monotonic()
        # one that is back is believed when asked again: what is behind it comes a little later
        self._routers = frozenset(told.keys() - (self._silent - self._back))
        self._back = told.keys() & self._silent
        if len(self._behind) > MOST_SESSIONS:
            self._behind.clear()
        self._behind |= {session: router for router, sessions in told.items() for session in sessions}

    def _without_routers(self, found: dict[str, bool]) -> dict[str, bool | None]:
        """Return which nodes run, where those that went with their router are unknown."""
        table: dict[str, bool | None] = dict(found)
        silent = set()
        for node, runs in found.items():
            session = self._node.graph.session_of(node)
            if not runs and not any(_of(self._near, session)):
                for router in _of(self._behind, session):
                    if router not in self._routers:
                        table[node] = None
                        silent.add(router)
        for router in silent - self._silent:
            why = "it does not answer any more: whether the nodes behind it run is unknown"
            self._node.problems.tell(f"the router {router}", why)
        for router in self._silent - silent:
            self._node.problems.over(f"the router {router}")
        self._silent = silent
        return table

    async def _look(self) -> dict[str, bool] | None:
        since_s = self._node.connected_s
        if since_s is None or time.monotonic() - since_s < self._settled_s:
            return None
        links = set(self._node.links)
        for link in self._processes.keys() - links:
            del self._processes[link]
        for link in links - self._processes.keys():
            process = self._processes[link] = await asyncio.to_thread(_process, link)
            if process is not None and len(self._near) < MOST_SESSIONS:
                self._near[link.session] = True
        works = {link.session: p.works() for link, p in self._processes.items() if p is not None}
        sessions = self._node.graph.sessions()
        return self._node.graph.nodes({s for s in sessions if not all(_of(works, s))})


def _process(link: Link) -> Process | None:
    """Return the process at the other end, where that is on this computer."""
    if not link.port or not is_ours(link.address):
        return None
    return has_open(lambda local, remote: (local, remote) == (link.port, link.own_port), ("tcp", "tcp6"))


def _of(works: Mapping[str, Known], session: str) -> Iterable[Known]:
    """Return what is known of a session, by its name in tokens: releases of 2024 leave out zeros."""
    for linked, runs in works.items():
        padded = linked.zfill(len(linked) + len(linked) % 2)
        short = "".join(f"{int(padded[n : n + 2], 16):x}" for n in range(0, len(padded), 2))
        if session in (linked, padded, short):
            yield runs
