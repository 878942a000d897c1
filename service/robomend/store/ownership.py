"""One owner per robot at a time, with a fencing number on everything it writes.

A robot's row names the instance that owns it. An instance lives as long as it holds its lock (session.py),
which the database server or the kernel frees when it dies, by whatever death. To acquire a robot, in one
transaction with its row locked:

    row names nobody, or an instance whose lock is free  ──►  name us, fencing number + 1
    row names us                                         ──►  the fence that we have
    row names an instance whose lock is held             ──►  None

There is one lock per instance, not one per robot: a server's lock table holds thousands, a fleet may have a
hundred thousand robots. An owner that was taken for dead and is not (its connection broke, it was suspended)
still believes in its fence; every write compares it with the row's, and refuses the older one (Fenced). So
two may believe, but one writes.

Reference: M. Kleppmann. Designing Data-Intensive Applications, chapter 8, fencing tokens. 2017.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import time
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import cast

from sqlalchemy import Connection, or_, select

from robomend.errors import RobomendError, StoreError
from robomend.store import schema
from robomend.store.interface import Store, Transaction, View
from robomend.store.reading import SqlView
from robomend.store.records import Fence
from robomend.store.session import InstanceSession
from robomend.store.transaction import SqlItem

HEARTBEAT_S = 15.0
FORGOTTEN_NS = 86_400_000_000_000
MAX_ORPHANS = 1000


class SqlOwnership:
    """robomend.store.interface.Ownership."""

    def __init__(self, store: Store, session: InstanceSession) -> None:
        self._store = store
        self._session = session
        self._held: dict[str, Fence] = {}
        self._callbacks: list[Callable[[Fence], None]] = []
        self._heart: asyncio.Task[None] | None = None
        self._started_ns = time.time_ns()

    @property
    def instance(self) -> str:
        return self._session.instance or ""

    @property
    def held(self) -> Mapping[str, Fence]:
        return MappingProxyType(self._held)

    def start(self) -> None:
        """Begin to say that we are there."""
        self._heart = asyncio.get_running_loop().create_task(self._beat())

    async def close(self) -> None:
        """Let all robots go."""
        if self._heart is not None:
            self._heart.cancel()
            await asyncio.wait({self._heart})
        instance = self._session.instance
        self._held.clear()
        if instance is not None:
            await self._store.write(lambda tx: leave(tx, instance))

    async def acquire(self, robot: str) -> Fence | None:
        held = self._held.get(robot)
        if held is not None:
            return held
        instance, lives = self._session.instance, self._session.lives
        if instance is None:
            return None
        fence = await self._store.write(lambda tx: own(tx, robot, instance, lives), robots=(robot,))
        if fence is None or self._session.instance != instance:
            return None
        self._held[robot] = fence
        return fence

    async def release(self, robot: str) -> None:
        fence = self._held.pop(robot, None)
        if fence is not None:
            await self._store.write(lambda tx: disown(tx, fence), robots=(robot,))

    async def orphans(self) -> tuple[str, ...]:
        session = self._session
        return await self._store.read(lambda view: orphans(view, session.instance, session.lives))

    def on_lost(self, callback: Callable[[Fence], None]) -> Callable[[], None]:
        self._callbacks.append(callback)

        def end() -> None:
            if callback in self._callbacks:
                self._callbacks.remove(callback)

        return end

    def lost(self) -> None:
        """Our lock is gone, and with it everything we held."""
        lost, self._held = list(self._held.values()), {}
        for fence in lost:
            for callback in tuple(self._callbacks):
                callback(fence)

    async def beat(self) -> None:
        instance = self._session.instance
        if instance is None:
            raise StoreError("the database dropped our lock, and it is not taken again yet")
        say = partial(
            beat, instance=instance, host=socket.gethostname(), pid=os.getpid(), started_ns=self._started_ns
        )
        await self._store.write(say)

    async def _beat(self) -> None:
        while True:
            with contextlib.suppress(RobomendError):  # for people only: the next one will do
                await self.beat()
            await asyncio.sleep(HEARTBEAT_S)


# --- the rows


Lives = Callable[[str, Connection], bool]
"""Whether an instance holds its lock."""


def own(tx: Transaction, robot: str, instance: str, lives: Lives) -> Fence | None:
    """Name `instance` as the owner if nobody living is."""
    item = cast(SqlItem, tx)
    state = item.existing(robot)
    if state.owner == instance:
        return Fence(robot, state.fence)
    if state.owner is not None and lives(state.owner, item.connection):
        return None
    table = schema.robot_state
    number = state.fence + 1
    item.change(table.update().where(table.c.robot == robot), {"owner": instance, "fence": number})
    item.now_is(robot, state._replace(owner=instance, fence=number))
    return Fence(robot, number)


def disown(tx: Transaction, fence: Fence) -> None:
    """Name nobody, unless somebody has taken over."""
    item = cast(SqlItem, tx)
    state = item.state(fence.robot)
    if state is not None and state.fence == fence.number:
        table = schema.robot_state
        item.change(table.update().where(table.c.robot == fence.robot), {"owner": None})
        item.now_is(fence.robot, state._replace(owner=None))


def leave(tx: Transaction, instance: str) -> None:
    """Name nobody for all that the instance owns, and forget the instance."""
    item = cast(SqlItem, tx)
    states, instances = schema.robot_state, schema.instances
    mine = [row.robot for row in item.rows(select(states.c.robot).where(states.c.owner == instance))]
    for robot in sorted(mine):
        fence = item.state(robot)
        if fence is not None and fence.owner == instance:
            disown(tx, Fence(robot, fence.fence))
    item.change(instances.delete().where(instances.c.id == instance))


def beat(tx: Transaction, *, instance: str, host: str, pid: int, started_ns: int) -> None:
    """Note that the instance is there, and forget those that have not been for a day."""
    item = cast(SqlItem, tx)
    table = schema.instances
    item.replace(
        table,
        {
            "id": instance,
            "host": host,
            "pid": pid,
            "started_ns": started_ns,
            "heartbeat_ns": item.now_ns,
        },
    )
    item.change(table.delete().where(table.c.heartbeat_ns < item.now_ns - FORGOTTEN_NS))


def orphans(view: View, instance: str | None, lives: Lives) -> tuple[str, ...]:
    """Return up to MAX_ORPHANS robots whose owner is dead or nobody, by name."""
    snapshot = cast(SqlView, view)
    states, robots = schema.robot_state, schema.robots
    owners = {row.owner for row in snapshot.rows(select(states.c.owner).distinct())}
    dead = [name for name in owners - {None, instance} if not lives(name, snapshot.connection)]
    query = (
        select(states.c.robot)
        .join(robots, robots.c.id == states.c.robot)
        .where(or_(states.c.owner.is_(None), states.c.owner.in_(dead)))
        .order_by(states.c.robot)
        .limit(MAX_ORPHANS)
    )
    return tuple(row.robot for row in snapshot.rows(query))
