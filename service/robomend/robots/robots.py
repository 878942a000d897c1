"""The robots of the service: OBS in, diagnoses out. Read this file to see what happens to an observation.

    observe: a batch ──read──► an update ──⊕──► OBS in memory ──► the store (durable) ──► acknowledged
                                                                     │ in the same transaction, or after it
                          long polls, streams, the repair loop ◄── the diagnosis, where it says something new

memory.py has the robots, a cache of the store keyed by revision; diagnosing.py writes and diagnoses;
configuring.py has what is set of each. All belongs to one event loop.
"""

from __future__ import annotations

import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import asynccontextmanager

import structlog

from robomend.board.link import LinkState
from robomend.diagnosis.result import DiagnosisResult
from robomend.entry import Entry
from robomend.errors import InputError, NotFound, ObservationError, Overloaded, RobomendError, StateConflict
from robomend.metrics import Metrics
from robomend.robots import configuring
from robomend.robots.batches import Acknowledged, Batch, Update, read_batches
from robomend.robots.boards import SOURCE, Boards, WiredBoard, board_update
from robomend.robots.clock import CLOCK
from robomend.robots.configuration import RobotConfig
from robomend.robots.diagnoser import Diagnoser
from robomend.robots.diagnosing import Diagnosing
from robomend.robots.health import Background, HealthWatch
from robomend.robots.memory import Memory
from robomend.robots.readers import Readers
from robomend.robots.reporters import OURSELVES, Reporter, Reports, note
from robomend.robots.robot import Robot
from robomend.robots.systems import Systems
from robomend.settings import Settings
from robomend.store import Store, Transaction, observations, start_ups
from robomend.store.records import IdempotencyKey, Json
from robomend_client.events import Event, Kind
from robomend_client.literals import Literal

SETTLE_S = 0.1
"""How long an answer waits for a diagnosis that is under way; a small model's takes a hundredth of it."""

LOOK_S = 0.25
"""How often a wait looks again, for a change that was lost with its database connection."""


class Waiting:
    """Those who wait for a diagnosis: long polls, requests that want the newest one, the repair loop.

    Belongs to one event loop.
    """

    def __init__(self, diagnosing: Diagnosing, metrics: Metrics, most: int) -> None:
        """`most` requests may be in a long poll."""
        self._diagnosing = diagnosing
        self._metrics = metrics
        self._most = most
        self.requests = 0
        metrics.on_demand("robomend_waiting", "requests in a long poll", (), lambda: [((), self.requests)])

    async def beyond(self, robot: Robot, after: int | None, timeout_s: float) -> None:
        """Return when there is a diagnosis of a revision newer than `after`, or than the current one.

        Raises:
            Overloaded: too many wait already.
        """
        deadline = time.monotonic() + timeout_s
        count = robot.diagnosed.value
        async with self.counted():
            if robot.stale:  # another instance knows more
                self._diagnosing.wake(robot)
            while not (self._diagnosing.closing or robot.gone):
                if after is not None and robot.current is not None and robot.current.revision > after:
                    return
                left = deadline - time.monotonic()
                now = await robot.diagnosed.beyond(count, left) if left > 0 else count
                if left <= 0 or (after is None and now > count):
                    return
                count = now

    async def settled(self, robot: Robot) -> None:
        """Have the diagnosis of OBS as it is now, or a newer one, if that is to be had in a moment.

        A small model's is made here and now, before it is published: whoever asks need not wait for the disk.
        Others are waited for a little, and so are writes under way, which memory has already.
        """
        revision, deadline = robot.revision, time.monotonic() + SETTLE_S
        while not (self._diagnosing.closing or robot.gone or _is_diagnosed(robot, revision)):
            left = deadline - time.monotonic()
            if robot.stale:  # another instance was faster
                if left <= 0:
                    return
                await robot.refreshed()
            elif not robot.writing and (current := self._diagnosing.at_once(robot, robot.revision)):
                robot.looked_up(current)
            elif left <= 0 or not (robot.writing or robot.diagnosing):
                return
            elif robot.writing:
                await robot.observed.beyond(robot.revision, left)
            else:
                await robot.diagnosed.beyond(robot.diagnosed.value, left)

    async def result(self, robot: Robot) -> DiagnosisResult:
        """Return the diagnosis of OBS as it is now, once there is one; a fault in its place is raised."""
        while True:
            await robot.refreshed()
            current = robot.current
            if current is not None and current.answer is not None and current.revision >= robot.revision:
                return current.answer.result_or_fault()
            count = robot.diagnosed.value
            if not robot.diagnosing:
                self._diagnosing.wake(robot)
            await robot.diagnosed.beyond(count, LOOK_S)

    @asynccontextmanager
    async def counted(self) -> AsyncIterator[None]:
        """Count a request that waits. Overloaded when there are too many."""
        if self.requests >= self._most:
            self._metrics.refused.labels("waiters").inc()
            raise Overloaded(f"{self.requests} requests wait already; that is the limit")
        self.requests += 1
        try:
            yield
        finally:
            self.requests -= 1


def _is_diagnosed(robot: Robot, revision: int) -> bool:
    """Return whether the current diagnosis is of this revision of OBS, or a newer one, and of this model."""
    current = robot.current
    return (
        current is not None and current.revision >= revision and current.model_version == robot.model.version
    )


class Renewing:
    """Batches that say nothing new, as observers send every second: they renew what is held, and that is all.

        a batch ──⊕──► OBS changes? ── yes ──► a revision: history, event, diagnosis (robots.py)
                            │ no
                            ▼
                       evidence and lifetimes in memory; lifetimes on the disk, in place

    So a robot to which nothing happens adds nothing to the database, however often it says so. Kept in full
    are: the first report of a key and source since the start, so that the history and the audit log have who
    reports; what comes while a repair or a drill is open, as each report is evidence then, which is looked
    for in the history after a crash and from other instances; what comes while a write is under way, as it
    may fail.

    Belongs to one event loop.
    """

    def __init__(self, store: Store, diagnosing: Diagnosing, reports: Reports) -> None:
        self._store = store
        self._diagnosing = diagnosing
        self._reports = reports

    async def keep(
        self,
        robot: Robot,
        update: Update,
        renewed: Sequence[Entry],
        by: Reporter,
        once: IdempotencyKey | None,
    ) -> Json | None:
        """Keep an update that OBS in memory has taken in, and that changed nothing; return what to answer.

        None: it is to be kept in full.

        Raises:
            StateConflict: another instance was faster (code "stale-revision").
        """
        more = update.retracted or update.asserted or update.withdrawn
        if more or robot.writing or not self._reports.known(robot.id, by, update):
            return None
        revision, ran = robot.revision, False

        def renew(tx: Transaction) -> Json:
            nonlocal ran
            ran = True
            tx.repeatable = update.dated
            kept = observations.renew(tx, robot.id, renewed, expected=revision)
            if not kept:
                tx.repeatable = True  # the write in full has the key
            return {"revision": revision, "changed": []} if kept else {}

        try:
            said = await self._store.write(renew, robots=(robot.id,), once=once)
        except BaseException:  # a cancellation too: nobody knows then whether it is on disk
            robot.not_kept()
            raise
        if not ran:  # a request with the same key was: what memory has is not what the store has
            robot.half_applied()
        elif said:
            self._diagnosing.confirm(robot)
            robot.observed.wake()
        return said or None


class Following:
    """What other instances did, as their events say: what is held of a robot here is old then, and read
    again.

    A state that is newer already, because this instance wrote the change, stays as it is.

    Belongs to one event loop.
    """

    def __init__(
        self,
        robots: Mapping[str, Robot],
        diagnosing: Diagnosing,
        deleted: Callable[[str], None],
    ) -> None:
        """`deleted` is called with the id of a robot that is gone."""
        self._robots = robots
        self._diagnosing = diagnosing
        self._deleted = deleted

    def follow(self, events: Sequence[Event]) -> None:
        """Take note of events in the order of the log; most are our own."""
        robot, state = None, None
        for event in events:
            if event.kind is Kind.MODEL:
                self._model(event)
            if event.robot is None:
                continue
            if event.robot != robot:  # a batch and its diagnosis come together
                robot, state = event.robot, self._robots.get(event.robot)
            if state is not None:
                self._robot(state, event)

    def _model(self, event: Event) -> None:
        for state in self._robots.values():
            if (
                state.stored.config.get("model") == event.data.get("name")
                and event.data.get("version") not in (None, state.model.version)
                and not state.stale
            ):
                state.changed_elsewhere()
                self._diagnosing.wake(state)

    def _robot(self, state: Robot, event: Event) -> None:
        kind, data = event.kind, event.data
        if kind is Kind.OBSERVATIONS:
            if data["revision"] > state.head:
                state.changed_elsewhere()
                if state.diagnosed.awaited:  # there is no event if the other's diagnosis says nothing new
                    self._diagnosing.wake(state)
        elif kind is Kind.DIAGNOSIS:
            state.diagnosed_elsewhere(data["revision"], event.time_ns, data)
        elif kind is Kind.ROBOT and data.get("etag") not in (None, state.stored.etag):
            state.changed_elsewhere()
            self._diagnosing.wake(state)
        elif kind is Kind.ROBOT and data.get("what") == "deleted":
            self._deleted(state.id)


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
            return read_batches(state.words, batches, self.readers, state.sight.dating(), by.name)

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
        if (state := self.memory.states.get(robot)) is not None:
            state.sight.declared.board(lost=link in {LinkState.CONNECTING, LinkState.DISCONNECTED})
        if not self.diagnosing.closing:
            data = {"link": str(link), "reason": reason}
            writing = self._store.write(lambda tx: tx.emit(Kind.BOARD, robot, data))
            self._background.begin(writing, "board event")
