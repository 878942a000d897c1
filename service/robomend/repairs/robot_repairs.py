"""The repairs of one robot: begins its repairs, carries them out, and takes up what a crash left.

    an open repair in the store? ──► carry it out     (after a crash: settle the journal, hear every observer)
    a reason to begin one?       ──► write it down, carry it out
    neither                      ──► wait for a diagnosis, a request, the clock

A reason is: the policy is `approve` or `auto`, the diagnosis is not healthy and has held for `hold_s`, no
stop is active, the time is inside a maintenance window, and it is not what the last repair gave up on. That
is tried again when the diagnosis changes, a person releases a component, the robot is configured anew, or
the back-off of a quarantine ends.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import structlog

from robomend.cycle import mend
from robomend.errors import NotFound, Refused, RobomendError, StoreError
from robomend.repairs.choosing import Chooser
from robomend.repairs.conclusions import (
    BadSets,
    conclusion,
    in_doubt,
    is_healthy,
    nobodys_fault,
    situation_of,
)
from robomend.repairs.executors.agent import AgentExecutor, AgentQueue
from robomend.repairs.executors.board import BoardExecutor
from robomend.repairs.executors.configured import executors
from robomend.repairs.executors.once import Once
from robomend.repairs.live_repair import LiveRepair, NotPermitted, Overtaken, Silent
from robomend.repairs.record import LOOP, Json, RepairRecord, repair_json
from robomend.repairs.reentry import Reentry, open_question
from robomend.repairs.signals import Declined, Halted, Signals
from robomend.robots.robot import Robot
from robomend.robots.robots import Robots
from robomend.store import Store, Transaction, View, attempts, audit, repairs, robots
from robomend.store.records import AuditEntry, Fence, Paging, Stop, StoredRepair
from robomend_client.actions import Executor
from robomend_client.events import Kind

log = structlog.get_logger("robomend.repairs.robot_repairs")

IDLE_S = 30.0
"""An event wakes us; this is for one that was lost."""

RETRY_S = 1.0
"""After a failure of the store or of a worker."""


@dataclass
class Dependencies:
    """What all repair loops of an instance share."""

    store: Store
    robots: Robots
    agents: AgentQueue
    chooser: Chooser
    programs: Mapping[str, Sequence[str]] = field(default_factory=dict)
    stop: Stop = field(default_factory=Stop)


class RobotRepairs:
    """See the module. One task; everything else only wakes it."""

    def __init__(self, needs: Dependencies, robot: str, fence: Fence) -> None:
        self.fence = fence
        self._needs = needs
        self._robot = robot
        self._news = asyncio.Event()  # something may have changed
        self._asked = asyncio.Event()  # there may be a request for the repair that runs
        self._look_up = True  # there may be an open repair in the store that we do not know of
        self._signals = Signals()
        self._given_up: BadSets | None = None
        self._retry_ns: int | None = None  # when what was given up on may be tried again
        self._unhealthy: tuple[BadSets, float] | None = None  # and since when, monotonic

    def poke(self) -> None:
        """There is a new diagnosis."""
        self._news.set()

    def asked(self) -> None:
        """Somebody wrote a repair, or a request for one."""
        self._look_up = True
        self._asked.set()
        self._news.set()

    def reconsider(self) -> None:
        """A person changed something: what was given up on may be worth another try."""
        self._given_up = None
        self._news.set()

    def stopped(self) -> None:
        """The global stop changed."""
        stop = self._needs.stop
        if stop.active:
            self._signals.end(by=stop.by or LOOP, reason=f"global stop: {stop.reason}", stop=True)
        self._news.set()

    async def run(self) -> None:
        """Keep the robot until it is lost, deleted, or the service ends."""
        await self._recall()
        while True:
            self._news.clear()
            wait_s = IDLE_S
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
                    log.info("let go", robot=self._robot, code=error.code, detail=str(error))
                    return
                log.warning("keeper", robot=self._robot, code=error.code, detail=str(error))
                wait_s = RETRY_S
            except Exception:  # a fault of ours must not leave the robot without its loop
                log.exception("keeper", robot=self._robot)
                wait_s = RETRY_S
            try:
                async with asyncio.timeout(wait_s):
                    await self._news.wait()
            except TimeoutError:
                self._look_up = True  # for an event that was lost

    async def _is_lost(self, error: RobomendError) -> bool:
        """Whether an error says that the robot is no longer ours: another instance has it, or it is gone."""
        if not isinstance(error, NotFound):
            return error.code == "fenced"
        try:
            await self._needs.store.read(robots.get, self._robot)
        except NotFound:
            return True
        except RobomendError:
            return False
        return False

    # --- beginning

    async def _recall(self) -> None:
        """Learn from the store what the last repair gave up on, unless a person changed something since."""

        def look(view: View) -> Json | None:
            page = repairs.page(view, self._robot, Paging(limit=1))
            if not page.items or page.items[0].open or reconsidered(view, page.items[0]):
                return None
            return page.items[0].data

        with contextlib.suppress(RobomendError):
            data = await self._needs.store.read(look)
            if data is not None and data.get("given_up") is not None:
                self._given_up = frozenset(tuple(bad) for bad in data["given_up"])
                self._retry_ns = data.get("retry_ns")

    async def _open_repair(self) -> StoredRepair | None:
        """Return the open repair; the store is asked only if there may be one, not at each diagnosis."""
        if not self._look_up:
            return None
        self._look_up = False
        try:
            page = await self._needs.store.read(repairs.page, self._robot, Paging(limit=1), open_only=True)
        except BaseException:
            self._look_up = True
            raise
        return page.items[0] if page.items else None

    async def _begin(self) -> tuple[StoredRepair | None, float]:
        """Return a new repair if there is a reason for one, and how long to wait if there is none yet."""
        state = await self._needs.robots.robot(self._robot)
        situation = situation_of(state)
        if situation is None:
            self._unhealthy = None
            if is_healthy(state):
                self._given_up = None
            return None, IDLE_S
        now = time.monotonic()
        if self._unhealthy is None or self._unhealthy[0] != situation:
            self._unhealthy = (situation, now)
        policy = self._needs.chooser.policy(state)
        held_s = now - self._unhealthy[1]
        if self._retry_ns is not None and time.time_ns() >= self._retry_ns:
            self._given_up = self._retry_ns = None
        if (
            state.config.policy == "observe"
            or state.system.parts is None
            or self._needs.stop.active
            or situation == self._given_up
        ):
            return None, IDLE_S
        if held_s < policy.hold_s:
            return None, policy.hold_s - held_s + 0.001
        if not policy.may_begin(time.time_ns()):
            return None, IDLE_S

        def begin(tx: Transaction) -> StoredRepair:
            open_ones = repairs.page(tx, self._robot, Paging(limit=1), open_only=True).items
            if open_ones:
                return open_ones[0]  # a person was faster
            data = {
                "policy": state.config.policy,
                "by": LOOP,
                "asked": False,
                "reason": "",
                "question": open_question(tx, self._robot),
            }
            repair = repairs.create(tx, self._robot, state="waiting", data=data, fence=self.fence)
            tx.emit(Kind.REPAIR, self._robot, repair_json(repair))
            tx.note(AuditEntry(LOOP, "repair.create", repair.id, self._robot, "the diagnosis is not healthy"))
            return repair

        return await self._needs.store.write(begin, robots=(self._robot,)), 0.0

    # --- carrying out

    async def _carry_out(self, repair: StoredRepair) -> None:
        state = await self._needs.robots.robot(self._robot)
        record = RepairRecord(self._needs.store, repair, self.fence, state.system.cnf.components)
        signals = self._signals = Signals()
        self.stopped()
        entry = Reentry(
            self._needs.store, self._needs.agents, self._needs.chooser, record, signals, self.fence
        )
        listener = asyncio.create_task(self._listen(repair.id, signals))
        situation = situation_of(state)
        declined = False
        try:
            heard_since = await entry.take_up(state)
            last = await mend(await self._live(state, record, heard_since))
            while (doubt := in_doubt(last)) is not None:  # nobody else may send it either: the repair stays
                heard_since = await entry.ask_about(doubt, state)
                last = await mend(await self._live(state, record, heard_since))
            situation = situation_of(state)
            outcome, reason = conclusion(last, signals, record.data)
            if outcome == "repaired":
                reason += nobodys_fault(state)
        except Halted as how:
            outcome, reason = "cancelled", signals.reason
            declined = isinstance(how, Declined)
        except Overtaken as error:
            outcome, reason = "cancelled", str(error)
            situation = None  # the new one may begin a repair of its own
        except (Silent, NotPermitted) as error:
            outcome, reason = "escalated", str(error)
        except StoreError:
            raise  # the repair stays open and is entered again
        except RobomendError as error:
            if await self._is_lost(error):
                raise
            log.warning(
                "repair failed", robot=self._robot, repair=repair.id, code=error.code, detail=str(error)
            )
            outcome, reason = "failed", f"{error.code}: {error}"
        except Exception as error:  # a fault of ours: a person must see it, and the loop lives on
            log.exception("repair failed", robot=self._robot, repair=repair.id)
            outcome, reason = "failed", f"an error in robomend: {type(error).__name__}: {error}"
        finally:
            listener.cancel()
            await asyncio.wait({listener})
        await self._end(entry, state, record, outcome, reason, situation, declined)

    async def _end(
        self,
        entry: Reentry,
        state: Robot,
        record: RepairRecord,
        outcome: str,
        reason: str,
        situation: BadSets | None,
        declined: bool,
    ) -> None:
        """Close the repair, and note what it gave up on and what it leaves to ask."""
        signals = self._signals
        left = await entry.left_open(state, reason)
        question = None if declined else left.question(reason) or record.data.get("question")
        if left.in_doubt:
            reason += f"; {left.in_doubt} was under way: nothing else is sent before a person has looked"
        gives_up = outcome != "repaired" and not signals.stopped
        self._given_up = situation if gives_up else None
        self._retry_ns = await self._next_try() if outcome == "escalated" else None
        await record.update(
            outcome,
            reason=reason,
            by=signals.by or LOOP,
            open=False,
            answers=signals.answers(),
            waiting_for=[],
            rounds=record.rounds_closed("halted", reason),
            question=question,  # what nobody answered: the robot's next repair asks it first
            also=left.settle,
            given_up=None if self._given_up is None else [list(bad) for bad in sorted(self._given_up)],
            retry_ns=self._retry_ns,
        )

    async def _next_try(self) -> int | None:
        """Return when the first back-off ends of the components that are in quarantine now."""
        entries = await self._needs.store.read(attempts.quarantine, self._robot)
        ends = [entry.until_ns for entry in entries if entry.until_ns and entry.until_ns > time.time_ns()]
        return min(ends, default=None)

    async def _live(self, state: Robot, record: RepairRecord, heard_since: int | None) -> LiveRepair:
        needs = self._needs
        return LiveRepair(
            store=needs.store,
            robots=needs.robots,
            chooser=needs.chooser,
            state=state,
            record=record,
            executors=await self._executors(state),
            signals=self._signals,
            heard_since=heard_since,
        )

    async def _executors(self, state: Robot) -> dict[str, Executor]:
        """Return who carries out what for this robot, as it is configured now."""
        needs = self._needs
        parts = state.system.parts
        if parts is None:
            raise Refused(f"a {state.system.format} model says nothing of what can be repaired")
        board = None
        if state.config.board is not None:
            wired = await needs.robots.board(state.id)
            channels = {name: channel for channel, name in wired.components.items()}
            board = Once(BoardExecutor(wired.link, channels, wired.protected))
        hosts = {name: node.host for name, node in parts.nodes.items()}
        return executors(
            needs.chooser.actions(state),
            state.config.actions,
            board=board,
            agent=AgentExecutor(needs.agents, needs.store, state.id, hosts, self._signals.halt),
            programs=needs.programs,
        )

    async def _listen(self, repair: str, signals: Signals) -> None:
        """Hand requests from the store to the running case."""
        while True:
            self._asked.clear()
            try:
                await self._hand_over(repair, signals)
            except RobomendError as error:
                log.warning("requests", robot=self._robot, code=error.code, detail=str(error))
            except Exception:  # else nobody could cancel any more
                log.exception("requests", robot=self._robot)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(RETRY_S):
                    await self._asked.wait()

    async def _hand_over(self, repair: str, signals: Signals) -> None:
        requests = await self._needs.store.read(repairs.requests, self._robot)
        for request in requests:
            if request.repair != repair:  # that one has ended
                await self._needs.store.write(partial(_answer, request.number, self.fence))
            elif request.what == "approve":
                signals.approve(by=request.by, request=request.number)
            else:
                signals.end(by=request.by, reason=request.reason or "cancelled", request=request.number)


RECONSIDERED = frozenset({"quarantine.release", "robot.put"})
"""Entries of the audit log after which what a repair gave up on is worth another try."""


def reconsidered(view: View, ended: StoredRepair) -> bool:
    """Return whether a person changed something since the repair ended; by the audit log, as its order is
    that of the writes and not of clocks.
    """
    for entry in audit.page(view, Paging(limit=1000), robot=ended.robot).items:  # the newest first
        if entry.subject == ended.id:
            return False
        if entry.action in RECONSIDERED:
            return True
    return False


def _answer(request: int, fence: Fence, tx: Transaction) -> None:
    repairs.answer(tx, request, fence=fence)
