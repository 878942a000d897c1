"""The robots of the service: OBS in, diagnoses out. Read this file to see what happens to an observation.

    observe ──► OBS ⊕ o in memory ──► the store (durable) ──► acknowledged
                                              │
                              wake ──► one diagnosis in flight and one pending per robot
                                              │
                 changed? ──► the store, with its event ──► long polls, streams, the repair loop

memory.py has the robots, a cache of the store keyed by revision; configuring.py what is set of each. All
belongs to one event loop.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Coroutine, Mapping, Sequence
from functools import partial
from itertools import chain
from typing import Any

import structlog

from robomend.board.link import LinkState
from robomend.errors import (
    InputError,
    NotFound,
    ObservationError,
    Overloaded,
    RobomendError,
    StateConflict,
    TooLarge,
)
from robomend.metrics import Metrics
from robomend.robots import configuring
from robomend.robots.batches import Acknowledged, Batch, ReadBatch, board_batch, read_batch
from robomend.robots.boards import SOURCE, Boards, WiredBoard
from robomend.robots.clock import CLOCK
from robomend.robots.configuration import RobotConfig
from robomend.robots.diagnoser import Diagnoser
from robomend.robots.diagnosing import SETTLE_S, Diagnosing, announce, same
from robomend.robots.following import Following
from robomend.robots.memory import Memory
from robomend.robots.robot import Changes, Robot
from robomend.robots.systems import Systems
from robomend.settings import Settings
from robomend.store import Store, Transaction, View, observations, records, robots
from robomend.store.records import AuditEntry, IdempotencyKey, Json
from robomend_client.events import Kind
from robomend_client.literals import Literal

log = structlog.get_logger("robomend.robots.robots")

ATTEMPTS = 8
"""Times that a batch is tried again when another instance was faster."""


class Robots:
    """See the module."""

    def __init__(self, store: Store, settings: Settings, metrics: Metrics, diagnoser: Diagnoser) -> None:
        self.models = Systems(store, settings)
        self._store = store
        self._settings = settings
        self._metrics = metrics
        self._boards = Boards(self._board_says, self._board_state)
        self._memory = Memory(
            store, self.models, settings.max_robots, taken_up=self._taken_up, left=self._boards.remove
        )
        self._tasks: set[asyncio.Task[None]] = set()
        self._unsubscribe: Callable[[], None] | None = None
        self.diagnosing = Diagnosing(store, settings, metrics, diagnoser, self.robot)
        self.models.on_change(self._model_changed)
        metrics.on_demand("robomend_robots", "robots in memory", (), lambda: [((), len(self._memory.states))])
        metrics.on_demand(
            "robomend_board_link",
            "1 for the state that the link is in",
            ("robot", "state"),
            lambda: [((robot, state), 1.0) for robot, state in self._boards.states().items()],
        )

    # --- life

    async def start(self) -> None:
        """Take up the robots that work without being asked: those with a board or a period."""
        following = Following(self._memory.states, self.diagnosing, self._deleted_elsewhere)
        self._unsubscribe = self._store.subscribe(following.follow)
        paging: records.Paging | None = records.Paging(limit=1000)
        while paging is not None:
            page = await self._store.read(partial(_page, paging))
            for stored in page.items:
                if stored.config.get("board") or stored.config.get("period_s"):
                    await self.robot(stored.id)
            paging = records.Paging(page.next, 1000) if page.next is not None else None

    def end_waits(self) -> None:
        """Let every long poll go, with what there is: the service shuts down."""
        self.diagnosing.closing = True
        for state in self._memory.states.values():
            state.diagnosed.wake()
            state.observed.wake()

    async def close(self) -> None:
        """Stop diagnosing and drop the boards; what was acknowledged is in the store already."""
        self.end_waits()
        if self._unsubscribe is not None:
            self._unsubscribe()
        await self._boards.close()
        for state in self._memory.states.values():
            state.cancel_timers()
        await self.diagnosing.close()
        for task in self._tasks:
            task.cancel()
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=5.0)

    def on_diagnosis(self, callback: Callable[[str], None]) -> None:
        """Call back with a robot's id after each of its diagnoses, new or confirmed; it must not block."""
        self.diagnosing.on_diagnosis(callback)

    # --- robots

    async def robot(self, robot: str) -> Robot:
        """Return a robot's state, read from the store if it is not in memory. NotFound."""
        return await self._memory.robot(robot)

    async def latest(self, robot: str) -> Robot:
        """Return a robot's state as the store has it: whatever another instance has acknowledged is in it."""
        return await self._memory.latest(robot)

    async def diagnosed(self, robot: str) -> Robot:
        """Return a robot's latest state with its diagnosis; one that is nearly there is waited for."""
        state = await self.latest(robot)
        revision, until = state.revision, time.monotonic() + SETTLE_S
        await self.diagnosing.settle(state, revision, until)
        while state.stale and not state.gone and time.monotonic() < until:  # another instance was faster
            state = await self.robot(robot)
            await self.diagnosing.settle(state, revision, until)
        return state

    async def put_robot(self, robot: str, config: Json, *, expected: str | None, by: str) -> Robot:
        """Create or replace a robot's configuration; OBS stays.

        Raises:
            PreconditionRequired, PreconditionFailed: see store.preconditions.
            InputError: what is configured does not fit the model.
        """
        _, system = await self.models.current(config["model"])
        await configuring.check(RobotConfig.from_json(robot, config), system)
        await self._store.write(
            lambda tx: configuring.put(tx, robot, config, expected=expected, by=by), robots=(robot,)
        )
        state = self._memory.states.get(robot)
        if state is not None:
            state.stale = True
        return await self.robot(robot)

    async def delete_robot(self, robot: str, *, expected: str, by: str) -> None:
        """Delete a robot; StateConflict while a repair is open."""
        await self._store.write(
            lambda tx: configuring.delete(tx, robot, expected=expected, by=by), robots=(robot,)
        )
        await self._memory.drop(robot)

    def _deleted_elsewhere(self, robot: str) -> None:
        self._spawn(self._memory.drop(robot), "robot deleted elsewhere")

    async def _taken_up(self, state: Robot) -> None:
        """Connect the board of a robot that was read from the store, and diagnose it."""
        await self._boards.put(state.id, state.config.board, state.system.parts)
        self.diagnosing.set_period(state)
        self.diagnosing.wake(state)

    # --- observations

    async def observe(self, robot: str, batch: Batch, *, once: IdempotencyKey | None = None) -> Acknowledged:
        """Take in a batch; when this returns, it is on disk. ObservationError names the sentence at fault."""
        return await self._observe(robot, lambda state: read_batch(state, batch), once)

    async def observe_all(
        self, robot: str, batches: Sequence[Batch], *, once: IdempotencyKey | None = None
    ) -> Acknowledged:
        """Take in several batches as one revision, all or none: what a stream brings."""

        def read_all(state: Robot) -> ReadBatch:
            parts = [read_batch(state, batch) for batch in batches]
            return ReadBatch(
                tuple(chain.from_iterable(part.observed for part in parts)),
                tuple(chain.from_iterable(part.asserted for part in parts)),
                refused=tuple(chain.from_iterable(part.refused for part in parts)),
            )

        return await self._observe(robot, read_all, once)

    async def _observe(
        self, robot: str, read: Callable[[Robot], ReadBatch], once: IdempotencyKey | None
    ) -> Acknowledged:
        state = await self.robot(robot)
        generation = state.generation
        try:
            return await self._accept(state, lambda: read(state), once)
        except ObservationError:
            latest = await self.latest(robot)
            if latest is state and state.generation == generation:
                raise
        # Another instance has given it a model that may well have this word.
        return await self._accept(latest, lambda: read(latest), once)

    async def withdraw(self, robot: str, assertion: str) -> Acknowledged:
        """Withdraw a named assertion."""
        state = await self.latest(robot)
        if assertion not in state.assertion_records:
            raise NotFound(f"robot {robot!r} has no assertion {assertion!r}")
        return await self._accept(state, lambda: ReadBatch(withdrawn=(assertion,)), None)

    async def _accept(
        self, state: Robot, read: Callable[[], ReadBatch], once: IdempotencyKey | None
    ) -> Acknowledged:
        """Take a batch into OBS and onto the disk; again from fresh OBS when another instance was faster."""
        for _ in range(ATTEMPTS):
            batch = read()
            if batch.empty:
                return Acknowledged(state.revision, (), batch.refused)
            room = self._settings.max_observed
            if len(state.obs) + len(batch.observed) > room and len(state.obs) >= room:
                raise TooLarge(f"OBS of robot {state.id!r} holds {room} literals; max_observed is reached")
            try:
                changes = state.apply(
                    batch.observed,
                    asserted=batch.asserted,
                    withdrawn=batch.withdrawn,
                    forgotten=batch.forgotten,
                )
            except InputError:
                state.stale = True  # part of the batch may be in memory
                raise
            try:
                kept = await self._write(state, changes, once)
            except StateConflict as error:
                if error.code != "stale-revision":
                    raise
                state = await self.robot(state.id)
                continue
            way = "board" if batch.observed and batch.observed[0].source == SOURCE else "http"
            self._metrics.observations.labels(way).inc(len(batch.observed))
            return Acknowledged(kept["revision"], tuple(kept["changed"]), batch.refused)
        raise Overloaded(f"robot {state.id!r} is written to by too many instances at once")

    async def _write(self, state: Robot, changes: Changes, once: IdempotencyKey | None) -> dict[str, Any]:
        """Write a batch that memory has already; if that fails, memory is read again from the store.

        The diagnosis goes into the same transaction if it can be had at once; else the robot is woken after
        it.
        """
        before, generation, began = state.head, state.generation, time.perf_counter()
        accepted_ns = time.time_ns()
        current = self.diagnosing.at_once(state, before + 1)
        is_new = current is not None and not same(state.announced, current)
        if current is not None and is_new:
            state.announced = current
        state.head = before + 1
        ran = False

        def keep(tx: Transaction) -> dict[str, Any]:
            nonlocal ran
            ran = True
            revision = observations.observe(
                tx,
                state.id,
                accepted=changes.accepted,
                changed=changes.kept,
                forgotten=changes.forgotten,
                asserted=changes.asserted,
                withdrawn=changes.withdrawn,
                expected=before,
            )
            said = {"revision": revision, "changed": changes.text}
            forgotten = [str(atom) for atom in changes.forgotten]
            told = {**said, "forgotten": forgotten, "accepted_ns": accepted_ns}
            tx.emit(Kind.OBSERVATIONS, state.id, told)
            if current is not None and is_new:
                announce(state.id, current, tx)
            return said

        try:
            kept = await self._store.write(keep, robots=(state.id,), once=once)
        except BaseException:  # a cancellation too: memory is ahead of the disk
            state.stale, state.announced = True, None
            state.observed.wake()  # whoever waits for this write looks, and reads it anew
            raise
        state.observed.advance(kept["revision"])
        state.changed_at = began
        if not ran or state.generation != generation:
            # A repeated key, or a write that a reload did not see: memory is read again before a diagnosis.
            state.stale, state.announced = True, None
        if current is not None and not state.stale:
            self.diagnosing.announced(state, current, time.perf_counter() - began)
        else:
            if state.waiting_since is None:
                state.waiting_since = began
            self.diagnosing.wake(state)
        return kept

    def _model_changed(self, name: str) -> None:
        """Recompile and diagnose anew for every robot in memory that follows the model."""
        for state in self._memory.states.values():
            if state.stored.config.get("model") == name:
                state.stale = True
                self.diagnosing.wake(state)

    # --- boards

    async def board(self, robot: str) -> WiredBoard:
        """Return a robot's board; NotFound if it has none."""
        await self.latest(robot)
        return self._boards.get(robot)

    async def switch(self, robot: str, channel: int, on: bool, *, by: str, reason: str) -> None:
        """Switch a channel of a robot's board, with an entry in the audit log before it is sent."""
        board = await self.board(robot)
        if board.link.channels is not None and channel >= board.link.channels:
            raise NotFound(f"the board of {robot!r} has channels 0 to {board.link.channels - 1}")
        entry = AuditEntry(
            actor=by,
            action="channel.on" if on else "channel.off",
            subject=f"channel {channel}",
            robot=robot,
            reason=reason,
        )
        await self._store.write(lambda tx: tx.note(entry))
        await board.switch(channel, on)

    def board_states(self) -> Mapping[str, str]:
        """Return the link state of each board in memory."""
        return self._boards.states()

    async def _board_says(self, robot: str, said: frozenset[Literal], time_ns: int) -> None:
        """Take what a board says into OBS: what is new, and to forget what it no longer says."""
        try:
            state = await self.robot(robot)
            batch = board_batch(state, said, CLOCK.now_ns())
            await self._accept(state, lambda: batch, None)
        except RobomendError as error:
            log.warning("board observation not kept", robot=robot, code=error.code, detail=str(error))

    def _board_state(self, robot: str, link: LinkState, reason: str) -> None:
        if self.diagnosing.closing:
            return
        data = {"link": str(link), "reason": reason}
        self._spawn(self._store.write(lambda tx: tx.emit(Kind.BOARD, robot, data)), "board event")

    def _spawn(self, work: Coroutine[Any, Any, None], name: str) -> None:
        async def run() -> None:
            try:
                await work
            except RobomendError as error:
                log.warning("not kept", what=name, code=error.code, detail=str(error))

        task = asyncio.create_task(run(), name=name)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


def _page(paging: records.Paging, view: View) -> records.Page[records.StoredRobot]:
    return robots.page(view, paging)
