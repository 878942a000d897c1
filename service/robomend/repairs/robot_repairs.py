"""The repairs of one robot: begins its repairs, carries them out, and takes up what a crash left.

    an open repair in the store? ──► carry it out     (after a crash: settle the journal, hear every observer)
    a reason to begin one?       ──► write it down, carry it out                     (reasons.py)
    neither                      ──► wait for a diagnosis, a request, the clock

Carrying out is robomend.cycle.mend over a LiveRepair. Whatever ends it, the repair is closed with an end in
words, or stays open and is entered again. Below: which robots are ours, and what wakes their loops.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Collection, Sequence

import structlog

from robomend.cycle import mend
from robomend.errors import NotFound, RobomendError, StoreError
from robomend.model.components import Criticality
from robomend.poller import Seeker, wait_for
from robomend.repairs.acts import Acts
from robomend.repairs.changes import Changes
from robomend.repairs.conclusions import BadSets, Silent, blamed_now, conclusion, end_of, in_doubt
from robomend.repairs.dependencies import Dependencies
from robomend.repairs.left_off import in_words
from robomend.repairs.live_repair import LiveRepair
from robomend.repairs.reasons import IDLE_S, ReasonsToRepair, takes_up
from robomend.repairs.record import LOOP, RepairRecord, answered, new_repair
from robomend.repairs.reentry import Reentry
from robomend.repairs.signals import Declined, Requests, Signals
from robomend.repairs.states import RepairState, RepairTrigger
from robomend.robots.health import HealthState, health_of
from robomend.robots.robot import Robot
from robomend.store import Transaction, drills, repairs, robots
from robomend.store.records import Fence, Json, Paging, Stop, StoredRepair
from robomend_client.events import Event, Kind

log = structlog.get_logger("robomend.repairs.robot_repairs")

ACTING = frozenset({RepairState.RUNNING, RepairState.VERIFYING})

RETRY_S = 1.0
"""After a failure of the store or of a worker."""


class RobotRepairs:
    """Of one robot: see the module. One task; everything else only wakes it."""

    def __init__(self, needs: Dependencies, robot: str, fence: Fence) -> None:
        self.fence = fence
        self._needs = needs
        self._robot = robot
        self._news = asyncio.Event()  # something may have changed
        self._look_up = True  # there may be an open repair in the store that we do not know of
        self._resting = False  # there was nothing to do, and nothing to be done soon
        self._reasons = ReasonsToRepair()
        self._signals = Signals(lambda: needs.switch.active)
        self._requests = Requests(needs.store, fence)
        self._record: RepairRecord | None = None  # of the repair that is carried out
        self.changes = Changes(needs, robot, fence, self._acted_on, self._left_off)

    def _acted_on(self) -> Collection[str] | None:
        """Return what the plan of a repair acts on that is under way; None: none is."""
        if self._record is None or self._record.state not in ACTING:
            return None
        return {name for step in self._record.data.get("plan", ()) for name in step["parameters"]}

    def _left_off(self) -> Collection[str]:
        return () if self._record is None else self._record.left_off.keys()

    # --- what wakes it

    def poke(self, state: Robot | None) -> None:
        """There is a new diagnosis; of most is seen here that they are no reason to act.

        Args:
            state: the robot, if it is in memory.
        """
        if state is None or state.functions:
            self.changes.wake()
        if not self._resting or self._reasons.any(state, self._needs.chooser, self._needs.switch.stop):
            self._news.set()

    def asked(self) -> None:
        """Somebody wrote a repair, or a request for one."""
        self._look_up = True
        self._requests.arrived.set()
        self._news.set()

    def reconsider(self) -> None:
        """A person changed something: what was given up on may be worth another try."""
        self._reasons.reconsider()
        self.changes.reconsider()
        self._news.set()

    def wake(self) -> None:
        """What the agents can do has changed."""
        self._news.set()

    def stopped(self) -> None:
        """The global stop changed."""
        stop = self._needs.switch.stop
        self.changes.stopped()
        if stop.active:
            self._signals.end(by=stop.by or LOOP, reason=f"global stop: {stop.reason}", stop=True)
        elif self._reasons.held_by_stop:  # nobody else: a fleet of healthy robots sleeps on
            self._news.set()

    async def run(self) -> None:
        """Look after the robot until it is lost, deleted, or the service ends."""
        changing = asyncio.create_task(self.changes.run(), name=f"configuration of {self._robot}")
        try:
            await self._run()
        finally:
            changing.cancel()
            await asyncio.wait({changing})

    async def _run(self) -> None:
        with contextlib.suppress(RobomendError):
            await self._needs.store.read(lambda view: self._reasons.recall(view, self._robot))
        while True:
            self._news.clear()
            self._resting, wait_s = False, IDLE_S
            try:
                repair = await self._open_repair()
                if repair is None:
                    repair, wait_s = await self._begin()
                if repair is not None:
                    self._look_up = True
                    await self._carry_out(repair)
                    continue
            except RobomendError as error:
                if await self._is_lost(error):
                    log.info(
                        "another instance repairs it now, or it is gone",
                        robot=self._robot,
                        code=error.code,
                        detail=str(error),
                    )
                    return
                log.warning("repairs are tried again", robot=self._robot, code=error.code, detail=str(error))
                wait_s = RETRY_S
            except Exception:  # a fault of ours must not leave the robot without its loop
                log.exception("repairs are tried again", robot=self._robot)
                wait_s = RETRY_S
            self._resting = wait_s >= IDLE_S and not self._look_up
            await wait_for(self._news, wait_s)

    async def _is_lost(self, error: Exception) -> bool:
        """Whether an error says that the robot is no longer ours: another instance has it, or it is gone."""
        if not isinstance(error, NotFound):
            return isinstance(error, RobomendError) and error.code == "fenced"
        try:
            await self._needs.store.read(robots.get, self._robot)
        except NotFound:
            return True
        except RobomendError:
            return False
        return False

    # --- beginning

    async def _open_repair(self) -> StoredRepair | None:
        """Return the open repair; the store is asked only if there may be one, not at each diagnosis."""
        if not self._look_up:
            return None
        self._look_up = False
        try:
            page = await self._needs.store.read(repairs.page, self._robot, Paging(limit=1), open_only=True)
        except BaseException:  # a cancellation too; it is raised again, and the store is asked anew
            self._look_up = True
            raise
        return page.items[0] if page.items else None

    async def _begin(self) -> tuple[StoredRepair | None, float]:
        """Return a new repair if there is a reason for one, and how long to wait if there is none yet."""
        state = await self._needs.robots.memory.robot(self._robot)
        self._needs.chooser.keep_ready(state)
        wait_s = self._reasons.wait_s(state, self._needs.chooser.policy(state), self._needs.switch.stop)
        if wait_s > 0:
            return None, wait_s

        def begin(tx: Transaction) -> StoredRepair | None:
            drill = drills.open_of(tx, self._robot)
            if drill is not None and (not drill.watched or answered(tx, drill)):
                return None  # it has its hands at the robot, or will; its next state wakes us
            open_ones = repairs.page(tx, self._robot, Paging(limit=1), open_only=True).items
            if open_ones:
                return open_ones[0]  # a person was faster
            again = self._reasons.again
            return new_repair(tx, self._robot, state.config.policy, fence=self.fence, again=again)

        begun = await self._needs.store.write(begin, robots=(self._robot,))
        return begun, 0.0 if begun is not None else RETRY_S

    # --- carrying out

    async def _carry_out(self, repair: StoredRepair) -> None:
        state = await self._needs.robots.memory.robot(self._robot)
        record = RepairRecord(self._needs.store, repair, self.fence, state.system.cnf.components)
        self._record = record
        signals = self._signals = Signals(lambda: self._needs.switch.active)
        self.stopped()
        entry = Reentry(
            self._needs.store, self._needs.agents, self._needs.chooser, record, signals, self.fence
        )
        listener = asyncio.create_task(self._requests.listen(repair.id, signals))
        blamed = at_first = blamed_now(state) or self._reasons.suspects  # which may have lapsed meanwhile
        declined = unlasting = unheard = False
        live: LiveRepair | None = None
        try:
            heard_since = await entry.take_up(state)
            live = await self._live(state, record, heard_since)
            last = await mend(live)
            while (doubt := in_doubt(last)) is not None:  # nobody else may send it either: the repair stays
                heard_since = await entry.ask_about(doubt, state)
                live = await self._live(state, record, heard_since)
                last = await mend(live)
            unlasting = last.choice is not None and last.choice.unlasting
            # well again, and not for long, or what was bad is not heard, or not diagnosed, at the moment
            well = health_of(state)[0] is HealthState.HEALTHY
            blamed = blamed_now(state) or (at_first if unlasting or not well else None)
            self.stopped()
            end, reason = conclusion(last, signals, record.data, state)
            unheard = end is RepairTrigger.OVERTAKEN  # it is blamed again, or nothing of the robot is known
            ends_well = end in {RepairTrigger.HEALTHY, RepairTrigger.UNSEEN}
            if ends_well and (told := self._reasons.well_by_itself(record, at_first)) is not None:
                end, reason = RepairTrigger.NEEDS_PERSON, told
        except StoreError:
            raise  # the repair stays open and is entered again
        except Exception as error:  # whatever it is: a person must see it, and the loop lives on
            if await self._is_lost(error):
                raise
            self.stopped()  # where the stop is younger than what the loop has heard of it
            end, reason = end_of(error, signals, record.data)
            declined, unheard = isinstance(error, Declined), isinstance(error, Silent)
            if end is RepairTrigger.OVERTAKEN:
                blamed = None  # the new one may begin a repair of its own
            elif end is RepairTrigger.NEEDS_PERSON:
                # By what came of its acts; a new repair would end as this one did.
                well = health_of(state)[0] is HealthState.HEALTHY
                blamed = blamed_now(state) or (None if well else at_first)
            elif end is RepairTrigger.BROKE:
                unforeseen = not isinstance(error, RobomendError)
                log.warning(
                    "repair failed", robot=self._robot, repair=repair.id, detail=reason, exc_info=unforeseen
                )
        finally:
            listener.cancel()
            await asyncio.wait({listener})
        if live is not None and end in {RepairTrigger.NEEDS_PERSON, RepairTrigger.BROKE}:
            await self._bring_back(live)
            self.stopped()
            if signals.halt.is_set():
                end, reason = RepairTrigger.HALTED, f"{signals.reason}; {reason}"
        how = {"declined": declined, "unlasting": unlasting, "unheard": unheard}
        await self._end(entry, state, record, end, reason, blamed, **how)
        self.changes.repair_ended()

    async def _bring_back(self, live: LiveRepair) -> None:
        """Let a repair that gives up leave nothing stopped or off by its doing."""
        try:
            await live.bring_back()
        except StoreError:
            raise  # the repair stays open and is entered again
        except Exception as error:  # it ends in any case, with what is left off in its reason
            if await self._is_lost(error):
                raise
            log.warning("what the repair stopped was not started again", robot=self._robot, exc_info=True)

    async def _end(
        self,
        entry: Reentry,
        state: Robot,
        record: RepairRecord,
        end: RepairTrigger,
        reason: str,
        blamed: BadSets | None,
        *,
        declined: bool,
        unlasting: bool,
        unheard: bool,
    ) -> None:
        """Close the repair, and note what it gave up on and what it leaves to ask."""
        signals = self._signals
        left = await entry.left_open(state, reason)
        if end in {RepairTrigger.NEEDS_PERSON, RepairTrigger.BROKE} and "suspect" not in reason:
            told = await self._needs.chooser.suspects(state, reason)  # there a person begins
            reason += f"; {told}" if told else ""
        question = None if declined else left.question(reason) or record.data.get("question")
        if left.in_doubt:
            reason += f"; {left.in_doubt} was under way: nothing else is sent before a person has looked"
        gives_up = end is not RepairTrigger.HEALTHY and not signals.stopped and record.drill is None
        retry_ns = await entry.next_try() if end is RepairTrigger.NEEDS_PERSON else None
        reason += in_words(state, record.left_off)
        person = end is RepairTrigger.NEEDS_PERSON
        unheard = unheard and (not person or not all(map(state.sight.reported, state.sight.observed)))
        interlocked = person and state.interlocked() is not None
        why = {"interlocked": interlocked, "unlasting": unlasting, "unheard": unheard}
        untouched = person and not record.data.get("rounds")
        broke, again = end is RepairTrigger.BROKE, None
        in_vain = person and (not untouched or bool(record.data.get("again")))  # it had something to try
        if gives_up and retry_ns is None and not interlocked and (broke or in_vain):
            retry_ns, again = takes_up(record, state, broke=broke)
        symptoms, declared = state.sight.symptoms(), state.sight.declared
        self._reasons.gave_up(
            blamed if gives_up else None,
            retry_ns,
            symptoms,
            untouched=untouched,
            takes_up=again,
            agents=declared.changes if untouched or declared.boardless else None,
            **why,
        )
        given_up = self._reasons.given_up
        await record.update(
            end,
            reason=reason,
            by=signals.by or LOOP,
            answers=signals.answers(),
            waiting_for=[],
            rounds=record.rounds_closed("halted", reason),
            question=question,  # what nobody answered: the robot's next repair asks it first
            also=left.settle,
            given_up=None if given_up is None else [list(bad) for bad in sorted(given_up)],
            retry_ns=retry_ns,
            takes_up=again,
            optional=_all_optional(state, blamed),
            **why,
        )

    async def _live(self, state: Robot, record: RepairRecord, heard_since: int | None) -> LiveRepair:
        needs, signals = self._needs, self._signals
        who = await needs.executors(state, signals.halt, self.fence)
        acts = await Acts.of(needs.store, state, record)
        around = (state, record, who, signals, heard_since, acts, self.changes.finished)
        return LiveRepair(needs.store, needs.robots, needs.chooser, *around)


def _all_optional(state: Robot, blamed: BadSets | None) -> bool:
    """Whether the robot can do without all that is blamed, whichever diagnosis is right."""
    parts = state.system.parts
    names = frozenset().union(*(blamed or ()))
    if parts is None or not names:
        return False
    return all(parts.parts[name].criticality is Criticality.OPTIONAL for name in names)


ORPHANS_S = 1.0
"""How often robots without an owner are looked for: a dead instance's robots are taken over in about this."""

LOST_S = 30.0
"""How often open repairs are looked for of which no event told: of all robots at once, as a thousand looks of
a thousand loops would come together and keep changes waiting."""

CLOSE_S = 3.0
"""For the loops to let go at shutdown."""

WAKING = frozenset({Kind.REPAIR, Kind.CONFIGURATION, Kind.ROBOT, Kind.DIAGNOSIS, Kind.DRILL, Kind.BOARD})
"""Kinds of events that a robot's loop must hear of."""


class RobotLoops:
    """The robots that this instance owns: one task with a RobotRepairs for each.

        orphan or new robot ──► acquire (a fence) ──► RobotRepairs, until the robot is lost or deleted
        event in the log    ──► wakes the one that it concerns, whichever instance wrote it
        open repair         ──► wakes its robot's, each LOST_S: of one whose event was lost

    Belongs to one event loop.
    """

    def __init__(self, needs: Dependencies) -> None:
        self._needs = needs
        self._store = needs.store
        self._switch = needs.switch
        self._loops: dict[str, RobotRepairs] = {}
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._let_go: set[str] = set()  # robots whose loop ended: released before they are kept again
        self._look_for_lost_s = 0.0
        self._seeker = Seeker(self._look, "robots without an owner", ORPHANS_S)
        self._ends: list[Callable[[], None]] = []

    async def start(self) -> None:
        """Begin to follow the events, then to look for robots without an owner."""
        self._ends = [
            self._store.subscribe(self._follow),
            self._store.ownership.on_lost(self._lost),
        ]
        # After following began, so that a stop in between is not missed.
        await self._switch.start()
        self._switch.on_change(self._stop_changed)
        self._needs.robots.diagnosing.on_diagnosis(self._poke)
        self._seeker.start()

    async def close(self) -> None:
        """Let go within a few seconds: running actions are cancelled, journals closed."""
        for end in self._ends:
            end()
        await self._seeker.close(self._tasks.values(), CLOSE_S)

    async def _look(self) -> None:
        await self._acquire()
        if time.monotonic() >= self._look_for_lost_s:
            for robot in await self._store.read(repairs.open_robots):
                if (loop := self._loops.get(robot)) is not None:
                    loop.asked()
            self._look_for_lost_s = time.monotonic() + LOST_S

    async def _acquire(self) -> None:
        """Make a loop for each robot that nobody owns, and for each of ours that has none."""
        await self._switch.look()
        ownership = self._store.ownership
        for robot in tuple(self._let_go):
            await ownership.release(robot)
            self._let_go.discard(robot)
        for robot in {*await ownership.orphans(), *ownership.held} - self._loops.keys():
            with contextlib.suppress(NotFound):  # deleted meanwhile
                fence = await ownership.acquire(robot)
                if fence is not None and robot not in self._loops:
                    self._keep(robot, fence)

    def _keep(self, robot: str, fence: Fence) -> None:
        loop = self._loops[robot] = RobotRepairs(self._needs, robot, fence)
        task = self._tasks[robot] = asyncio.create_task(loop.run(), name=f"running of {robot}")
        task.add_done_callback(lambda _: self._ended(robot, loop))

    def _ended(self, robot: str, loop: RobotRepairs) -> None:
        if self._loops.get(robot) is loop:
            del self._loops[robot], self._tasks[robot]
            # The fence may be an old one, of a robot that another instance has or that was deleted.
            self._let_go.add(robot)
            self._seeker.wake()

    def _lost(self, fence: Fence) -> None:
        loop = self._loops.get(fence.robot)
        if loop is not None and loop.fence == fence:
            self._tasks[fence.robot].cancel()

    def wake(self, robot: str) -> None:
        """What the agents of a robot can do has changed."""
        loop = self._loops.get(robot)
        if loop is not None:
            loop.wake()

    def _poke(self, state: Robot) -> None:
        loop = self._loops.get(state.id)
        if loop is not None:
            loop.poke(state)

    def _follow(self, events: Sequence[Event]) -> None:
        for event in events:
            kind, robot = event.kind, event.robot
            if kind is Kind.STOP:
                self._switch.heard(_stop_of(event.data))
            elif robot is not None and kind in WAKING:
                loop = self._loops.get(robot)
                if kind is Kind.ROBOT and event.data.get("what") == "deleted":
                    task = self._tasks.get(robot)
                    if task is not None:
                        task.cancel()
                elif loop is None:
                    self._seeker.wake()
                elif kind is Kind.REPAIR:
                    loop.asked()
                elif kind is Kind.CONFIGURATION:
                    loop.changes.asked()
                elif kind is Kind.ROBOT and event.data.get("what") in {"updated", "released"}:
                    loop.reconsider()
                else:
                    state = self._needs.robots.memory.states.get(robot)
                    if kind is not Kind.DIAGNOSIS or not _ours(state, event):
                        loop.poke(state)

    def _stop_changed(self) -> None:
        for loop in self._loops.values():
            loop.stopped()


def _ours(state: Robot | None, event: Event) -> bool:
    """Return whether a diagnosis is one of which `_poke` hears, as it is published here."""
    return state is not None and state.has_announced(event.data["revision"])


def _stop_of(data: Json) -> Stop:
    active, reason = bool(data.get("active")), data.get("reason", "")
    return Stop(active, data.get("by"), reason, data.get("since_ns"), data.get("revision", 0))
