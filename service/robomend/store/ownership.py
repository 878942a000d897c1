"""One owner per robot at a time, with a fencing number on everything it writes.

A robot's row names the instance that owns it. An instance lives as long as it holds its lock (session.py),
which the database server or the kernel frees when it dies, by whatever death. To acquire a robot, in one
transaction with its row locked:

    row names nobody, or an instance whose lock is free  ──►  name us, fencing number + 1
    row names us                                         ──►  the fence that we have
    row names an instance whose lock is held             ──►  None (until it has said nothing for GONE_S)

There is one lock per instance, not one per robot: a server's lock table holds thousands, a fleet may have a
hundred thousand robots. An owner that was taken for dead and is not (its connection broke, it was suspended)
still believes in its fence; every write compares it with the row's, and refuses the older one (Fenced). So
two may believe, but one writes. What is not a write (a frame to a board, an answer to an agent) is sent after
`confirm`: an owner that was heard just now cannot have lost a robot; any other reads its fence first.

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

from sqlalchemy import Connection, bindparam, or_, select

from robomend.errors import Fenced, RobomendError, StoreError
from robomend.store import schema
from robomend.store.records import Fence, Instance
from robomend.store.rows import View
from robomend.store.session import InstanceSession
from robomend.store.transaction import Transaction
from robomend.store.writer import StoreThreads

HEARTBEAT_S = 15.0
TURN_S = 0.2
"""How often the event loop says that it turns."""
CONFIRM_S = 5.0
"""For an owner that is not sure to become so."""
LOOK_S = 0.02
FORGOTTEN_NS = 86_400_000_000_000
MAX_ORPHANS = 1000


class Ownership:
    """The robots that this instance owns. All methods belong to the event loop that started the store."""

    def __init__(self, store: StoreThreads, session: InstanceSession) -> None:
        self._store = store
        self._session = session
        self._held: dict[str, Fence] = {}
        self._known: dict[
            str, tuple[str, int]
        ] = {}  # robot -> our name, and naps, when it was ours for certain
        self._callbacks: list[Callable[[Fence], None]] = []
        self._heart: asyncio.Task[None] | None = None
        self._turning: asyncio.Task[None] | None = None
        self._started_ns = time.time_ns()

    @property
    def instance(self) -> str:
        """The name of this instance, a new one at every start."""
        return self._session.instance or ""

    @property
    def held(self) -> Mapping[str, Fence]:
        """The robots owned now."""
        return MappingProxyType(self._held)

    def begin_turning(self) -> None:
        """Let the session know, from now on, that the event loop turns."""
        self._session.turned()
        self._turning = asyncio.get_running_loop().create_task(self._turn(), name="the loop turns")

    async def _turn(self) -> None:
        """Say that the event loop turns; after it did not, let go what others have taken over meanwhile."""
        naps = self._session.naps
        while True:
            self._session.turned()
            await asyncio.sleep(TURN_S)
            if self._session.naps != naps:
                naps = self._session.naps
                before = dict(self._held)
                with contextlib.suppress(RobomendError):  # then the next write finds out
                    self._drop(before, await self._store.read(owned, self._session.instance))

    def _drop(self, before: Mapping[str, Fence], ours: Mapping[str, int]) -> None:
        """Let go what we held before, and is not among these, robot -> fencing number."""
        for robot, fence in before.items():
            if ours.get(robot) != fence.number and self._held.get(robot) == fence:
                del self._held[robot], self._known[robot]
                for callback in tuple(self._callbacks):
                    callback(fence)

    def start(self) -> None:
        """Begin to say that we are there."""
        self._heart = asyncio.get_running_loop().create_task(self._beat())

    async def close(self) -> None:
        """Let all robots go."""
        for task in filter(None, (self._heart, self._turning)):
            task.cancel()
            await asyncio.wait({task})
        instance = self._session.instance
        self._held.clear()
        if instance is not None:
            await self._store.write(lambda tx: leave(tx, instance))

    async def acquire(self, robot: str) -> Fence | None:
        """Own the robot, with a higher fencing number than ever before; None while a live instance has it.

        Owning it already gives the same fence again. NotFound if there is no such robot.
        """
        held = self._held.get(robot)
        if held is not None:
            return held
        instance, lives, naps = self._session.instance, self._session.lives, self._session.naps
        if instance is None:
            return None
        fence = await self._store.write(lambda tx: own(tx, robot, instance, lives), robots=(robot,))
        if fence is None or self._session.instance != instance:
            return None
        self._held[robot], self._known[robot] = fence, (instance, naps)
        return fence

    async def confirm(self, fence: Fence) -> None:
        """Return when the robot is ours for certain, usually at once and without a pause.

        To be awaited right before something is sent: whoever slept, and was taken for dead, finds out here.

        Raises:
            Fenced: another instance has taken over, or may have.
            StoreError: the database does not say.
        """
        session, robot = self._session, fence.robot
        deadline = time.monotonic() + CONFIRM_S
        while True:
            if self._held.get(robot) != fence or self._known[robot][0] != session.instance:
                raise Fenced(f"{robot!r} was lost while this instance slept or hung")
            naps = session.naps
            if session.sure:
                if self._known[robot][1] == naps == session.naps:
                    return
                # Who took over has done so by now, or finds that we live: the row is locked to look.
                await self._store.write(lambda tx: tx.check_fence(robot, fence), robots=(robot,))
                if self._held.get(robot) == fence:
                    self._known[robot] = (self._known[robot][0], naps)
            elif time.monotonic() > deadline:
                raise StoreError("whether the robot is still ours cannot be said now")
            else:
                await asyncio.sleep(LOOK_S)

    async def release(self, robot: str) -> None:
        """Let the robot go; nothing happens if it is not ours."""
        fence = self._held.pop(robot, None)
        self._known.pop(robot, None)
        if fence is not None:
            await self._store.write(lambda tx: disown(tx, fence), robots=(robot,))

    async def orphans(self) -> tuple[str, ...]:
        """Return the robots whose last owner is dead or that nobody owns,
        to be acquired: ask every second or so.
        """
        return await self._store.read(orphans, self._session.instance, self._session.lives)

    async def instances(self) -> tuple[Instance, ...]:
        """Return the instances that live, this one included once it has said so: information for people."""
        return await self._store.read(instances, self._session.lives)

    def on_lost(self, callback: Callable[[Fence], None]) -> Callable[[], None]:
        """Call back, in the event loop, for each robot lost because the database dropped our lock.

        Until then our fence may already be refused; nothing may be sent for the robot after it. Returns a
        function that ends it.
        """
        self._callbacks.append(callback)

        def end() -> None:
            if callback in self._callbacks:
                self._callbacks.remove(callback)

        return end

    def lost(self) -> None:
        """Our lock is gone, and with it everything we held."""
        lost, self._held, self._known = list(self._held.values()), {}, {}
        for fence in lost:
            for callback in tuple(self._callbacks):
                callback(fence)

    async def beat(self) -> None:
        """Write that this instance is there; raises where it cannot be written."""
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

# Asked each second: made once.
_OWNERS = select(schema.robot_state.c.owner).distinct()
_ORPHANS = (
    select(schema.robot_state.c.robot)
    .join(schema.robots, schema.robots.c.id == schema.robot_state.c.robot)
    .where(
        or_(
            schema.robot_state.c.owner.is_(None),
            schema.robot_state.c.owner.in_(bindparam("dead", expanding=True)),
        )
    )
    .order_by(schema.robot_state.c.robot)
    .limit(MAX_ORPHANS)
)

Lives = Callable[[str, Connection], bool]
"""Whether an instance holds its lock."""


def own(tx: Transaction, robot: str, instance: str, lives: Lives) -> Fence | None:
    """Name `instance` as the owner if nobody living is."""
    state = tx.existing(robot)
    if state.owner == instance:
        return Fence(robot, state.fence)
    if state.owner is not None and lives(state.owner, tx.connection):
        return None
    table = schema.robot_state
    number = state.fence + 1
    tx.change(table.update().where(table.c.robot == robot), {"owner": instance, "fence": number})
    tx.now_is(robot, state._replace(owner=instance, fence=number))
    return Fence(robot, number)


def disown(tx: Transaction, fence: Fence) -> None:
    """Name nobody, unless somebody has taken over."""
    state = tx.state(fence.robot)
    if state is not None and state.fence == fence.number:
        table = schema.robot_state
        tx.change(table.update().where(table.c.robot == fence.robot), {"owner": None})
        tx.now_is(fence.robot, state._replace(owner=None))


def leave(tx: Transaction, instance: str) -> None:
    """Name nobody for all that the instance owns, and forget the instance."""
    states, instances = schema.robot_state, schema.instances
    mine = [row.robot for row in tx.rows(select(states.c.robot).where(states.c.owner == instance))]
    for robot in sorted(mine):
        fence = tx.state(robot)
        if fence is not None and fence.owner == instance:
            disown(tx, Fence(robot, fence.fence))
    tx.change(instances.delete().where(instances.c.id == instance))


def beat(tx: Transaction, *, instance: str, host: str, pid: int, started_ns: int) -> None:
    """Note that the instance is there, and forget those that have not been for a day."""
    table = schema.instances
    row = {"id": instance, "host": host, "pid": pid, "started_ns": started_ns, "heartbeat_ns": tx.now_ns}
    if tx.connection.dialect.name == "sqlite":  # on PostgreSQL the session says so, and must not wait for us
        tx.replace(table, row)
    tx.change(table.delete().where(table.c.heartbeat_ns < tx.now_ns - FORGOTTEN_NS))


def owned(view: View, instance: str | None) -> dict[str, int]:
    """Return the robots that an instance owns, with their fencing numbers."""
    table = schema.robot_state
    found = view.rows(select(table.c.robot, table.c.fence).where(table.c.owner == instance))
    return {row.robot: row.fence for row in found}


def instances(view: View, lives: Lives) -> tuple[Instance, ...]:
    """Return the instances that said that they are there and hold their lock, by name."""
    table = schema.instances
    return tuple(
        Instance(row.id, row.host, row.pid, row.started_ns, row.heartbeat_ns)
        for row in view.rows(select(table).order_by(table.c.id))
        if lives(row.id, view.connection)
    )


def orphans(view: View, instance: str | None, lives: Lives) -> tuple[str, ...]:
    """Return up to MAX_ORPHANS robots whose owner is dead or nobody, by name."""
    owners = {row.owner for row in view.rows(_OWNERS)}
    dead = [name for name in owners - {None, instance} if not lives(name, view.connection)]
    return tuple(row.robot for row in view.rows(_ORPHANS, {"dead": dead}))
