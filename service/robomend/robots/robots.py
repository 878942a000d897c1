"""The robots of the service: OBS in, diagnoses out. Read this file to see what happens to an observation.

    observe: a batch ──read──► an update ──⊕──► OBS in memory ──► the store (durable) ──► acknowledged
                                                                     │ in the same transaction, or after it
                          long polls, streams, the repair loop ◄── the diagnosis, where it says something new

memory.py has the robots, a cache of the store keyed by revision; diagnosing.py writes and diagnoses;
configuring.py has what is set of each. All belongs to one event loop.
"""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable

import structlog

from robomend.board.link import LinkState
from robomend.errors import InputError, NotFound, ObservationError, Overloaded, RobomendError, StateConflict
from robomend.metrics import Metrics
from robomend.robots import configuring
from robomend.robots.background import Background
from robomend.robots.batches import Acknowledged, Batch, Update, read_batches
from robomend.robots.boards import SOURCE, Boards, WiredBoard, board_update
from robomend.robots.clock import CLOCK
from robomend.robots.configuration import RobotConfig
from robomend.robots.diagnoser import Diagnoser
from robomend.robots.diagnosing import Diagnosing
from robomend.robots.following import Following
from robomend.robots.health import HealthWatch
from robomend.robots.memory import Memory
from robomend.robots.readers import Readers
from robomend.robots.renewing import Renewing
from robomend.robots.reporters import OURSELVES, Reporter, Reports, note
from robomend.robots.robot import Robot
from robomend.robots.systems import Systems
from robomend.robots.waiting import Waiting
from robomend.settings import Settings
from robomend.store import Store, Transaction, observations, start_ups
from robomend.store.records import IdempotencyKey, Json
from robomend_client.events import Kind
from robomend_client.literals import Literal

log = structlog.get_logger("robomend.robots.robots")

ATTEMPTS = 8
"""Times that a batch is tried again when another instance was faster."""


class Robots:
    """See the module."""

    def __init__(
        self, store: Store, settings: Settings, metrics: Metrics, diagnoser: Diagnoser, readers: Readers
    ) -> None:
        self.models = Systems(store, settings, readers)
        self.readers = readers
        self.boards = Boards(store, self._hear_board, self._board_repeats, self._board_changed, metrics)
        self.memory = Memory(
            store, self.models, settings.max_robots, taken_up=self._taken_up, left=self.boards.remove
        )
        self.diagnosing = Diagnosing(store, settings, metrics, diagnoser)
        self._health = HealthWatch(store, metrics, self.memory.states)
        self.diagnosing.on_diagnosis(self._health.look)
        self.waiting = Waiting(self.diagnosing, metrics, settings.max_waiters)
        self._store = store
        self._settings = settings
        # Looking a label up costs more than counting.
        self._from_boards, self._from_http = (metrics.observations.labels(way) for way in ("board", "http"))
        self._background = Background()
        self._reports = Reports()
        self._renewing = Renewing(store, self.diagnosing, self._reports)
        self._unsubscribe: Callable[[], None] = lambda: None
        self.models.on_change(self._model_changed)

    # --- observations

    async def observe(
        self, robot: str, *batches: Batch, by: Reporter = OURSELVES, once: IdempotencyKey | None = None
    ) -> Acknowledged:
        """Take in batches as one revision; when this returns, they are on disk.

        Raises:
            ObservationError: names the sentence at fault.
            TooLarge, Overloaded: OBS is full; too many instances write to this robot.
        """

        def read(state: Robot) -> Awaitable[Update]:
            return read_batches(state.words, batches, self.readers, state.sight.evidence(), by.name)

        state = self.memory.at_hand(robot) or await self.memory.robot(robot)
        generation = state.generation
        try:
            return await self._accept(state, read, by, once)
        except ObservationError:
            latest = await self.memory.latest(robot)
            if latest is state and state.generation == generation:
                raise
        # Another instance has given it a model that may well have this word.
        return await self._accept(latest, read, by, once)

    async def withdraw(self, robot: str, assertion: str, *, by: Reporter = OURSELVES) -> Acknowledged:
        """Withdraw a named assertion."""
        state = await self.memory.latest(robot)
        if assertion not in state.assertion_records:
            raise NotFound(f"robot {robot!r} has no assertion {assertion!r}")
        return await self._accept(state, Update(withdrawn=(assertion,)).ready, by)

    async def _accept(
        self,
        state: Robot,
        read: Callable[[Robot], Awaitable[Update]],
        by: Reporter,
        once: IdempotencyKey | None = None,
    ) -> Acknowledged:
        """Take an update into OBS and onto the disk; again, on fresh OBS, if another instance was faster."""
        for _ in range(ATTEMPTS):
            system = state.system
            update = await read(state)
            if state.stale or state.system is not system:  # reading it took a while
                await state.refreshed()
                if state.system is not system:
                    continue
            if update.empty:
                return Acknowledged(state.revision, (), update.refused)
            update.check_room(state.obs, self._settings)
            try:
                said = await self._keep(state, update, by, once)
            except StateConflict as error:
                if error.code != "stale-revision":
                    raise
                await state.refreshed()
                continue
            board = update.entries and update.entries[0].source == SOURCE
            (self._from_boards if board else self._from_http).inc(len(update.entries))
            return Acknowledged(said["revision"], said["changed"], update.refused)
        raise Overloaded(f"robot {state.id!r} is written to by too many instances at once")

    async def _keep(self, state: Robot, update: Update, by: Reporter, once: IdempotencyKey | None) -> Json:
        """Take an update into OBS in memory, and write it with its event and, if possible, its diagnosis."""
        accepted_ns = time.time_ns()
        try:
            applied = state.apply(update)
        except InputError:
            state.half_applied()
            raise
        if not applied.changed:
            same = await self._renewing.keep(state, update, applied.renewed, by, once)
            if same is not None:
                return same
        before, started = state.head, state.sight.start_ups.unwritten()
        reports = self._reports.due(state.id, by, update)

        def batch(tx: Transaction) -> Json:
            revision = observations.observe(
                tx,
                state.id,
                accepted=update.entries,
                changed=applied.changed,
                renewed=applied.renewed,
                forgotten=applied.forgotten,
                asserted=[record for _, record in update.asserted],
                withdrawn=update.withdrawn,
                expected=before,
                by=by.name,
                accepted_ns=accepted_ns,
            )
            note(tx, state.id, by, update, revision, reports)
            if started:
                start_ups.keep(tx, state.id, started)
            changed = [str(entry.literal) for entry in applied.changed if not entry.contradicted]
            return {"revision": revision, "changed": changed}

        written = await self.diagnosing.write(state, batch, once)
        if reports:
            self._reports.noted(state.id, by, update)
        return written

    async def _hear_board(self, robot: str, said: frozenset[Literal], time_ns: int) -> None:
        """Take what a board says into OBS."""
        try:
            state = await self.memory.robot(robot)
            update = board_update(state.obs, state.system.vocabulary, said, CLOCK.now_ns())
            await self._accept(state, update.ready, OURSELVES)
        except RobomendError as error:
            log.warning("board observation not kept", robot=robot, code=error.code, detail=str(error))

    def _board_repeats(self, robot: str, said: frozenset[Literal]) -> None:
        if (state := self.memory.states.get(robot)) is not None:
            state.sight.said_again(said, CLOCK.now_ns())  # no news, but evidence of now

    # --- robots

    async def diagnosed(self, robot: str) -> Robot:
        """Return a robot as the store has it, with its diagnosis; one that is nearly there is waited for."""
        state = await self.memory.latest(robot)
        await self.waiting.settled(state)
        return state

    async def board(self, robot: str) -> WiredBoard:
        """Return a robot's board; NotFound if it has none."""
        await self.memory.latest(robot)
        return self.boards.get(robot)

    async def put_robot(
        self, robot: str, config: Json, *, expected: str | None, by: str, reason: str = ""
    ) -> Robot:
        """Create or replace a robot's configuration; OBS stays.

        Raises:
            PreconditionRequired, PreconditionFailed: see store.preconditions.
            InputError: what is configured does not fit the model.
        """
        _, system = await self.models.current(config["model"])
        await configuring.check(RobotConfig.from_json(robot, config), system, self.readers)
        await self._store.write(
            lambda tx: configuring.put(tx, robot, config, expected=expected, by=by, reason=reason),
            robots=(robot,),
        )
        if (state := self.memory.states.get(robot)) is not None:
            state.changed_elsewhere()
        return await self.memory.robot(robot)

    async def delete_robot(self, robot: str, *, expected: str, by: str, reason: str = "") -> None:
        """Delete a robot; StateConflict while a repair is open."""
        await self._store.write(
            lambda tx: configuring.delete(tx, robot, expected=expected, by=by, reason=reason),
            robots=(robot,),
        )
        await self.memory.drop(robot)

    # --- life

    async def start(self) -> None:
        """Take up the robots that work without being asked: those with a board or a period."""
        following = Following(self.memory.states, self.diagnosing, self._deleted_elsewhere)
        self._unsubscribe = self._store.subscribe(following.follow)
        await self.memory.take_up_working()

    def end_waits(self) -> None:
        """Let every long poll go, with what there is: the service shuts down."""
        self.diagnosing.closing = True
        for state in self.memory.states.values():
            state.diagnosed.wake()
            state.observed.wake()

    async def close(self) -> None:
        """Stop diagnosing and drop the boards; what was acknowledged is in the store already."""
        self.end_waits()
        self._unsubscribe()
        await self.boards.close()
        for state in self.memory.states.values():
            state.cancel_timers()
        await self.diagnosing.close()
        await self._health.close()
        await self._background.close()

    # --- what happens elsewhere

    async def _taken_up(self, state: Robot) -> None:
        """Connect the board of a robot that was read from the store, and diagnose it."""
        await self.boards.put(state.id, state.config, state.system.parts)
        self.diagnosing.set_period(state)
        self.diagnosing.wake(state)

    def _model_changed(self, name: str) -> None:
        """Recompile and diagnose anew for every robot in memory that follows the model."""
        for state in self.memory.states.values():
            if state.stored.model == name:
                state.changed_elsewhere()
                self.diagnosing.wake(state)

    def _deleted_elsewhere(self, robot: str) -> None:
        self._background.begin(self.memory.drop(robot), "robot deleted elsewhere")

    def _board_changed(self, robot: str, link: LinkState, reason: str) -> None:
        if not self.diagnosing.closing:
            data = {"link": str(link), "reason": reason}
            writing = self._store.write(lambda tx: tx.emit(Kind.BOARD, robot, data))
            self._background.begin(writing, "board event")
