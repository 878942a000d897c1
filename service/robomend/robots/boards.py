"""The power boards of the robots: a link for each robot that has one, and its literals for OBS.

    link ──► snapshot ──► hardware observer ──► literals, when they change ──► OBS (source "board")
                │                                    └─ when they do not ──► what acts made uncertain is seen
                └─ silent: its literals are unknown, so they are forgotten

A board speaks at its broadcast rate, mostly to say what it said before; only what changed goes to the store.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import replace

from robomend.board.link import BoardLink, LinkState, Snapshot
from robomend.entry import Entry
from robomend.errors import NotFound, Refused, RobomendError
from robomend.metrics import Metrics
from robomend.model.components import ComponentModel
from robomend.model.vocabulary import Vocabulary
from robomend.observations.obs import Obs
from robomend.planning.protection import Protection, protected_channels
from robomend.robots.batches import Update
from robomend.robots.configuration import BoardConfig, RobotConfig, protection_of
from robomend.store import Store, Transaction, global_stop
from robomend.store.records import AuditEntry, Stop
from robomend_client.literals import Literal
from robomend_client.observers import BOARD, BoardReadings, HardwareObserver, Wiring

SOURCE = "board"
CONNECT_S = 2.0
"""How long a command waits for a link that is just coming up."""

Report = Callable[[str, frozenset[Literal], int], Awaitable[None]]
"""Robot, everything that its board says now, time in nanoseconds; what is not said is not known any more."""

Repeat = Callable[[str, frozenset[Literal]], None]
"""Robot, everything that its board says now, as it did before."""


class WiredBoard:
    """One robot's board: the link, the observer, and what was last told to OBS."""

    def __init__(
        self,
        store: Store,
        robot: str,
        config: BoardConfig,
        protected: Protection,
        parts: ComponentModel | None,
        report: Report,
        repeat: Repeat,
        on_state: Callable[[str, LinkState, str], None],
    ) -> None:
        hardware = parts.hardware if parts is not None else {}
        self.robot = robot
        self.config = config
        self.components: Mapping[int, str] = {
            device.channel: name for name, device in hardware.items() if device.channel is not None
        }
        self.protected = (
            dict.fromkeys(config.protected, "it is protected")
            if parts is None
            else protected_channels(parts, protected, config.protected)
        )
        self._observer = HardwareObserver(
            {name: _wiring(channel, config) for channel, name in self.components.items()},
            BoardReadings(rate_hz=config.rate_hz, lifetime_s=max(3.0, 3 / config.rate_hz)),
        )
        self._store = store
        self._report = report
        self._repeat = repeat
        self._told: frozenset[Literal] | None = None  # None: what OBS holds is from before this link
        self._task: asyncio.Task[None] | None = None
        self.link = BoardLink(
            config.host,
            config.port,
            broadcast_hz=config.rate_hz,
            on_state=lambda state, reason: on_state(robot, state, reason),
        )

    @property
    def told(self) -> bool:
        """Whether the board has spoken since we started: only then is what OBS holds of it from now.

        Once it has, a board that falls silent takes its literals out of OBS itself.
        """
        return self._told is not None

    def start(self) -> None:
        """Connect, and report from now on."""
        self.link.start()
        self._task = asyncio.create_task(self._listen(), name=f"board of {self.robot}")

    async def close(self) -> None:
        """Drop the link and say nothing more."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait([self._task], timeout=1.0)
        await self.link.close()

    async def switch(
        self,
        channel: int,
        on: bool,
        *,
        stop: Callable[[], Stop],
        interlocked: Callable[[], str | None],
        by: str,
        reason: str,
        confirm: Callable[[], Awaitable[None]] | None = None,
    ) -> None:
        """Switch a channel, with an entry in the audit log before it is sent, and one if it did not work.

        `confirm` is awaited right before it is sent, and raises where that is nobody's business any more.

        Refused for switching off a protected one, while the robot is interlocked, and during the global
        stop; BoardError as the link has it.
        """
        if self.link.channels is not None and channel >= self.link.channels:
            raise NotFound(f"the board of {self.robot!r} has channels 0 to {self.link.channels - 1}")
        entry = AuditEntry(
            actor=by,
            action="channel.on" if on else "channel.off",
            subject=f"channel {channel}",
            robot=self.robot,
            reason=reason,
        )

        def note(tx: Transaction) -> None:
            _check_stop(global_stop.hold(tx))  # another instance's, of which we may not have heard
            tx.note(entry)

        _check_stop(stop())
        await self._store.write(note)
        try:
            if not on and channel in self.protected:
                raise Refused(f"channel {channel} is protected: {self.protected[channel]}")
            await self.link.wait_connected(CONNECT_S)
            if (why := interlocked()) is not None:
                raise Refused(why)
            if confirm is not None:
                await confirm()
            _check_stop(stop())  # it may have come while the link came up
            await self.link.switch(channel, on)
        except RobomendError as error:
            failed = replace(
                entry, action=f"{entry.action}.failed", after={"error": f"{error.code}: {error}"}
            )
            await self._store.write(lambda tx: tx.note(failed))
            raise

    async def _listen(self) -> None:
        async for snapshot in self.link.measurements():
            await self._tell(snapshot)

    async def _tell(self, snapshot: Snapshot) -> None:
        self._observer.feed(BOARD, snapshot.time_ns, snapshot.channels)
        said = frozenset(self._observer.check(snapshot.time_ns))
        if said == self._told:
            self._repeat(self.robot, said)
            return
        await self._report(self.robot, said, snapshot.time_ns)
        self._told = said


def board_update(obs: Obs, vocabulary: Vocabulary, said: frozenset[Literal], time_ns: int) -> Update:
    """Return what a board changes in OBS by saying this: what is new, and to forget what it says no more."""
    entries = [
        Entry(literal, SOURCE, time_ns, since_ns=time_ns)
        for literal in sorted(said)
        if vocabulary.declares(literal.atom)
        and ((held := obs.get(literal.atom)) is None or held.literal != literal)
    ]
    atoms = {literal.atom for literal in said}
    gone = [
        (entry.atom, SOURCE) for entry in obs.entries() if entry.source == SOURCE and entry.atom not in atoms
    ]
    return Update(entries, retracted=gone)


def _check_stop(stop: Stop) -> None:
    if stop.active:
        raise Refused(f"the global stop is active, set by {stop.by}: {stop.reason}")


def _wiring(channel: int, config: BoardConfig) -> Wiring:
    expected = config.expected_currents.get(channel)
    if expected is None:
        return Wiring(channel)
    return Wiring(channel, expected.current_a, expected.tolerance_a)


class Boards:
    """The boards by robot."""

    def __init__(
        self,
        store: Store,
        report: Report,
        repeat: Repeat,
        on_state: Callable[[str, LinkState, str], None],
        metrics: Metrics | None = None,
    ) -> None:
        self._store = store
        self._report = report
        self._repeat = repeat
        self._on_state = on_state
        self._boards: dict[str, WiredBoard] = {}
        if metrics is not None:
            metrics.on_demand(
                "robomend_board_link",
                "1 for the state that the link is in",
                ("robot", "state"),
                lambda: [((robot, state), 1.0) for robot, state in self.states().items()],
            )

    def get(self, robot: str) -> WiredBoard:
        """Return a robot's board; NotFound if none is configured."""
        board = self._boards.get(robot)
        if board is None:
            raise NotFound(f"robot {robot!r} has no board configured")
        return board

    def made(self, robot: str, config: RobotConfig, parts: ComponentModel | None) -> WiredBoard | None:
        """Return the board that is configured, not connected yet."""
        if config.board is None:
            return None
        protected = protection_of(config, parts)
        tell = (self._report, self._repeat, self._on_state)
        return WiredBoard(self._store, robot, config.board, protected, parts, *tell)

    async def put(self, robot: str, config: RobotConfig, parts: ComponentModel | None) -> None:
        """Make the robot's board what is configured; the link stays if nothing about it changed."""
        old = self._boards.get(robot)
        new = self.made(robot, config, parts)
        if (
            old is not None
            and new is not None
            and (old.config, old.components, old.protected) == (new.config, new.components, new.protected)
        ):
            return
        await self.remove(robot)
        if new is not None:
            self._boards[robot] = new
            new.start()

    async def remove(self, robot: str) -> None:
        """Close the robot's link, if it has one."""
        board = self._boards.pop(robot, None)
        if board is not None:
            await board.close()

    async def close(self) -> None:
        """Close all links."""
        await asyncio.gather(*(self.remove(robot) for robot in tuple(self._boards)))

    def states(self) -> dict[str, str]:
        """Return each board's link state."""
        return {robot: str(board.link.state) for robot, board in self._boards.items()}
