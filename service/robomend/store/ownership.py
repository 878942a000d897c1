"""One owner per robot at a time, with a fencing number on everything it writes; and the session, by which an
instance shows that it lives, and hears when others have written.

A robot's row names the instance that owns it. An instance lives as long as it holds its lock,
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

The session is the instance's standing link to its database:

    PostgreSQL   one connection that holds an advisory lock of ours and LISTENs; the server frees the lock
                 when the connection ends, however it ends
    SQLite       a lock file beside the database (flock, freed by the kernel when the process ends), and a
                 look at SQLite's data_version every 50 ms

Who wants to know whether another instance lives tries its lock. One that hangs (SIGSTOP, an event loop that
is held) keeps its lock, so it also says when its event loop turned last: in its row, by the server's clock,
or in its lock file, by the clock of the computer. After GONE_S without news others take its robots over.

    event loop ── turned() ──► this thread ── every BEAT_S ──► row or lock file ◄── lives() of the others

A sleeper that wakes may have lost what it owned: `naps` counts, and whoever owns asks the database. A new
name is drawn whenever the lock was lost, so that nothing written under the old name counts as ours again.

Where everybody is starved of the processor, nobody can tell who hangs: who was late itself lately judges
nobody, and an event loop that does not turn because the processor is elsewhere (robomend.starvation) is said
to turn.

Reference: M. Kleppmann. Designing Data-Intensive Applications, chapter 8, fencing tokens. 2017.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import os
import secrets
import socket
import sqlite3
import struct
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from select import POLLIN, poll
from types import MappingProxyType
from typing import Any

from sqlalchemy import URL, Connection, bindparam, or_, select, text

from robomend.errors import Fenced, RobomendError, StoreError
from robomend.starvation import OwnSilence, waited_s
from robomend.store import schema
from robomend.store.records import Fence, Instance
from robomend.store.rows import NEWEST_EVENT, View
from robomend.store.transaction import CHANNEL, Transaction
from robomend.store.writer import StoreThreads

# --- the session: an instance's lock, its word that it lives, and its ear

POLL_S = 0.05
"""SQLite: how late an event of another process may come."""
PING_S = 0.3
"""PostgreSQL: how often the connection is looked at, when nothing comes."""
TOLD_S = 0.002
"""PostgreSQL: from a sign to looking at it. What we committed ourselves has come to the event loop by then,
and need not wake it; and of many signs the newest counts."""
BEAT_S = 0.4
"""Between two words of ours that we live."""
SURE_S = 2.0
"""After our last word nobody has taken over what is ours, for so long at least."""
GONE_S = 3.0
"""Without a word for so long, an instance is taken for dead."""
LATE_S = 1.0
"""Between two words of ours, or from the event loop's turn to the word of it: we are starved ourselves."""
CALM_S = 1.0
"""After we were late, before we judge others."""
BACK_OFF_S = (0.1, 0.2, 0.5, 1.0, 2.0)
READY_S = 5.0

# An end that falls silent is noticed within 4 s on both sides.
_CLIENT = {"tcp_user_timeout": "4000", "keepalives_idle": "1", "keepalives_interval": "1"}
_SERVER = (
    "-c tcp_keepalives_idle=1 -c tcp_keepalives_interval=1 -c tcp_keepalives_count=2"
    " -c tcp_user_timeout=4000 -c idle_session_timeout=0"
)


_NOW_NS = "(extract(epoch FROM clock_timestamp()) * 1000000000)::bigint"
_SAY = f"""
    INSERT INTO instances (id, host, pid, started_ns, heartbeat_ns) VALUES (%s, %s, %s, %s, {_NOW_NS} - %s)
    ON CONFLICT (id) DO UPDATE SET heartbeat_ns = excluded.heartbeat_ns
"""
_HEARD = text(f"SELECT {_NOW_NS} - heartbeat_ns FROM instances WHERE id = :id")
_TURNED = struct.Struct("<d")


def boot_s() -> float:
    """Return the time since the computer was booted, its sleep included: the same for all processes."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class InstanceSession(ABC):
    """A thread that keeps the link and takes it up again when it breaks.

    `on_sign(newest event id)` and `on_lost()` are called in that thread.
    """

    def __init__(self, on_sign: Callable[[int], None], on_lost: Callable[[], None]) -> None:
        self._on_sign = on_sign
        self._on_lost = on_lost
        self._instance: str | None = None
        self._turned_s = self._told_s = boot_s()
        self._beat_s = self._late_s = -GONE_S
        self._heard_s = self._turned_s
        self._silence = OwnSilence(self._turned_s, waited_s())
        self._waited_s = waited_s()
        self.naps = 0
        """Times that nothing was heard of us for so long that others may have taken over."""
        self._ready = threading.Event()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="store-session", daemon=True)

    @property
    def instance(self) -> str | None:
        """Our name; None while we hold no lock."""
        return self._instance

    def turned(self) -> None:
        """The event loop turns; to be called by it, more often than every BEAT_S."""
        self._turned_s = boot_s()

    @property
    def sure(self) -> bool:
        """Whether what we own is ours for certain: nobody can take us for dead yet."""
        return self._instance is not None and boot_s() - self._told_s < SURE_S

    def start(self) -> None:
        """Start, and wait until the lock is held. Blocking.

        Raises:
            StoreError: it was not within 5 s.
        """
        self._thread.start()
        if not self._ready.wait(READY_S):
            self.close()
            raise StoreError("no lock could be taken beside the database within 5 s")

    def close(self) -> None:
        """Free the lock and end the thread. Blocking, well under a second."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join(READY_S)

    def lives(self, instance: str, connection: Connection) -> bool:
        """Return whether another instance holds its lock and was heard lately.

        `connection` is in a transaction.
        """
        if not self._holds(instance, connection):
            return False
        now = boot_s()
        judges = self.sure and now - self._beat_s < LATE_S and now - self._late_s > CALM_S
        return not judges or self._silent_s(instance, connection) <= GONE_S

    @abstractmethod
    def _holds(self, instance: str, connection: Connection) -> bool:
        """Return whether an instance holds its lock."""

    @abstractmethod
    def _silent_s(self, instance: str, connection: Connection) -> float:
        """Return for how long an instance has said nothing; 0 if it has said nothing so far."""

    @abstractmethod
    def _hold(self) -> None:
        """Take the lock, say so with `_taken`, and serve until closing; raise when the link breaks."""

    def _taken(self, instance: str) -> None:
        self._instance = instance
        self._ready.set()

    def _beat(self, say: Callable[[float], object]) -> None:
        """Say, now and then, when the event loop turned last, or would have if it had had a processor."""
        now = boot_s()
        since_s = now - self._beat_s
        if since_s < BEAT_S:
            return
        if since_s > LATE_S or now - self._turned_s > LATE_S:
            self._late_s = now
        self._beat_s = now
        told_s = self._turns_s(now)
        say(told_s)
        if boot_s() - self._told_s > SURE_S:
            self.naps += 1  # before we are sure again: whoever asks `sure` first, and then this, knows
        self._told_s = told_s

    def _turns_s(self, now: float) -> float:
        waited, before = waited_s(), self._waited_s
        self._waited_s = waited
        turned_s = self._turned_s
        if turned_s != self._heard_s:  # since the last word, at which it had waited for so long as `before`
            self._heard_s = turned_s
            self._silence = OwnSilence(turned_s, before)
        return turned_s + self._silence.excused_s(now, waited)

    def _run(self) -> None:
        failures = 0
        while not self._closing.is_set():
            with contextlib.suppress(Exception):  # whatever broke the link, it is taken up again
                self._hold()
            if self._instance is not None:
                failures = 0
                self._instance = None
                if not self._closing.is_set():
                    self._on_lost()
            self._closing.wait(BACK_OFF_S[min(failures, len(BACK_OFF_S) - 1)])
            failures += 1


class PostgresSession(InstanceSession):
    """An advisory lock and LISTEN on one connection."""

    def __init__(self, url: URL, on_sign: Callable[[int], None], on_lost: Callable[[], None]) -> None:
        super().__init__(on_sign, on_lost)
        _, arguments = url.get_dialect()().create_connect_args(url)
        self._arguments: dict[str, Any] = {**arguments, **_CLIENT}
        self._arguments["options"] = f"{self._arguments.get('options', '')} {_SERVER}"

    def _holds(self, instance: str, connection: Connection) -> bool:
        # Shared, so that several who ask at once do not take each other for the instance.
        asked = text("SELECT pg_try_advisory_xact_lock_shared(:key)")
        return not connection.execute(asked, {"key": _lock_key(instance)}).scalar_one()

    def _silent_s(self, instance: str, connection: Connection) -> float:
        silent_ns = connection.execute(_HEARD, {"id": instance}).scalar()
        return 0.0 if silent_ns is None else float(silent_ns) / 1e9

    def _hold(self) -> None:
        from robomend.store.bounded import BoundedConnection

        with BoundedConnection.connect(**self._arguments, autocommit=True) as connection:
            instance = secrets.token_hex(8)
            connection.execute("SELECT pg_advisory_lock(%s)", (_lock_key(instance),))
            connection.execute(f"LISTEN {CHANNEL}")
            connection.execute("SET synchronous_commit = off")  # of what is said here the latest counts
            us = (instance, socket.gethostname(), os.getpid(), time.time_ns())

            def say(turned_s: float) -> None:
                connection.execute(_SAY, (*us, round((boot_s() - turned_s) * 1e9)))

            self._beat(say)
            # What comes while something else is said or asked goes here, too.
            connection.add_notify_handler(lambda notification: self._on_sign(int(notification.payload)))
            row = connection.execute("SELECT value FROM counters WHERE name = 'event'").fetchone()
            self._taken(instance)
            self._on_sign(row[0] if row else 0)
            hearing = poll()
            hearing.register(connection.fileno(), POLLIN)
            while not self._closing.is_set():
                if hearing.poll(PING_S * 1000):
                    time.sleep(TOLD_S)
                    newest = _newest(connection.pgconn)
                    if newest is not None:
                        self._on_sign(newest)
                else:
                    connection.execute("SELECT 1")
                self._beat(say)


def _newest(link: Any) -> int | None:
    """Return the newest event that a connection was told of, of all that has come; None: of none.

    Raises:
        psycopg.OperationalError: the connection is lost.
    """
    link.consume_input()
    newest: int | None = None
    while (told := link.notifies()) is not None:
        newest = int(told.extra)
    return newest


class SqliteSession(InstanceSession):
    """A locked file, and a look at the database now and then."""

    def __init__(self, path: Path, on_sign: Callable[[int], None], on_lost: Callable[[], None]) -> None:
        super().__init__(on_sign, on_lost)
        self._path = path
        self._locks = path.with_name(path.name + ".instances")

    def _holds(self, instance: str, connection: Connection) -> bool:
        return not _free(self._locks / f"{instance}.lock")

    def _silent_s(self, instance: str, connection: Connection) -> float:
        try:
            said = (self._locks / f"{instance}.lock").read_bytes()
        except FileNotFoundError:  # just now
            return 0.0
        return 0.0 if len(said) < _TURNED.size else boot_s() - float(_TURNED.unpack_from(said)[0])

    def _hold(self) -> None:
        self._locks.mkdir(mode=0o700, exist_ok=True)
        for old in self._locks.glob("*.lock"):
            _free(old)
        instance = secrets.token_hex(8)
        path = self._locks / f"{instance}.lock"
        # Not inheritable (Python's default): no worker process keeps the lock alive for a dead service.
        lock = os.open(path, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._watch(instance, lambda turned_s: os.pwrite(lock, _TURNED.pack(turned_s), 0))
        finally:
            path.unlink(missing_ok=True)
            os.close(lock)

    def _watch(self, instance: str, say: Callable[[float], object]) -> None:
        connection = sqlite3.connect(self._path, isolation_level=None, timeout=1.0)
        try:
            seen = None
            self._taken(instance)
            while not self._closing.is_set():
                self._beat(say)
                # data_version changes with every commit of another connection; it costs no disk access.
                version = connection.execute("PRAGMA data_version").fetchone()
                if version != seen:
                    row = connection.execute(NEWEST_EVENT).fetchone()
                    seen = version
                    self._on_sign(row[0] if row else 0)
                self._closing.wait(POLL_S)
        finally:
            connection.close()


def _lock_key(instance: str) -> int:
    return int.from_bytes(bytes.fromhex(instance), signed=True)


def _free(path: Path) -> bool:
    """Return whether nobody holds this lock file, and remove it then."""
    try:
        lock = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    except FileNotFoundError:
        return True
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        path.unlink(missing_ok=True)
        return True
    except BlockingIOError:
        return False
    finally:
        os.close(lock)


# --- who owns which robot

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
        self._known: dict[str, tuple[str, int]] = {}  # robot -> our name and naps when it was surely ours
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
