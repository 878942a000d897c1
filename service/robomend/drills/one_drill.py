"""One drill: from its beginning, or from where a crash left it, to its end.

    waiting ─► planting ─► planted ─► undoing ─► recovering ─► done
               │ the undo is on disk before the act; whatever goes wrong from here on leads to `undoing`
               └ after a crash: nobody knows what was planted, so that it is undone

The global stop forbids acts, and an undo is one: it starts a process, gives a device its power, lets a
driver go on that was halted with its last command. So a stop leaves the fault as it is, `stopped`, and the
undo is the first thing after it is lifted.
"""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass
from functools import partial
from operator import eq

import structlog

from robomend.drills.hands import AgentsHand, BoardsHand, EmulatorsHand, Hand, PersonsHand
from robomend.drills.permission import check, fault_of
from robomend.drills.record import DrillRecord, DrillState, DrillTrigger
from robomend.drills.watching import (
    Gone,
    Watching,
    acted_on_by_repair,
    healthy_for,
    heard,
    left_off_by,
    not_heard_since,
    repair_of,
    resting_on,
)
from robomend.errors import InputError, NotFound, RobomendError, StateConflict, StoreError
from robomend.planning.faults import AGENTS_FAULTS, EMULATED, FaultKind, drivers_of, taken_by
from robomend.poller import wait_for
from robomend.repairs.agent_queue import AgentQueue
from robomend.repairs.conclusions import named
from robomend.repairs.executors.registry import Surroundings, executors
from robomend.repairs.repair_json import repair_json
from robomend.repairs.signals import Halted, Signals
from robomend.repairs.states import RepairState
from robomend.repairs.stop_switch import StopSwitch
from robomend.robots.clock import CLOCK
from robomend.robots.robot import Robot
from robomend.robots.robots import Robots
from robomend.settings import Settings
from robomend.store import Store, Transaction, repairs
from robomend.store.records import AuditEntry, DrillRequest, Fence, StoredDrill, StoredRepair
from robomend_client.actions import REFUSED, UNDONE_BEFORE, UNREACHABLE, Action
from robomend_client.events import Kind


@dataclass(frozen=True)
class DrillNeeds:
    """What the drills of all robots share."""

    store: Store
    robots: Robots
    agents: AgentQueue
    switch: StopSwitch
    settings: Settings

    def tell_cancelled(self, tx: Transaction, repair: StoredRepair, why: str) -> None:
        """Tell the repair's owner, and the audit log, that it is asked to end."""
        asked = {**repair_json(repair), "asked": "cancel", "asked_by": "robomend"}
        tx.emit(Kind.REPAIR, repair.robot, asked)
        tx.note(AuditEntry("robomend", "repair.cancel", repair.id, repair.robot, why))


log = structlog.get_logger("robomend.drills.one_drill")

TAKEN_UP_NS = 30_000_000_000
"""A drill that nobody took up for so long is not begun: whoever asked for it may be gone."""

LOOK_S = 1.0
"""An event tells of a request; this is for one that was lost."""

REPAIR_ENDS_S = 15.0
"""For the drill's repair to finish its plan; and again to end when it is cancelled."""

AT_IT = frozenset({RepairState.RUNNING, RepairState.VERIFYING})

LONGEST_PAUSE_S = 5.0
"""Between two tries to undo."""

RECOVERED_S = 60.0
"""For the robot to be seen to be healthy after the undo, on a busy computer too."""

HELD_S = (1.0, 10.0)
"""It must be so for as long as its slowest observer needs, within these."""

NODE_S = 30.0
"""For the restart of a driver."""


class OneDrill:
    """See the module. One task; everything else only wakes it."""

    def __init__(self, needs: DrillNeeds, drill: StoredDrill, fence: Fence) -> None:
        self.news = asyncio.Event()  # something may have changed: a diagnosis, a request, the stop
        self._needs = needs
        self._record = DrillRecord(needs.store, drill, fence)
        self._fence = fence
        self._confirm = partial(needs.store.ownership.confirm, fence)
        self._signals = Signals(lambda: needs.switch.active)
        self._arrived = asyncio.Event()  # there may be a request
        self._done = asyncio.Event()  # a person said so
        self._heard_ns = 0  # the newest request that was heard
        self._request: DrillRequest | None = None  # a cancellation, or a person's word, not answered yet
        self._why = "the service was restarted in the middle of it, or another instance took it over"

    def asked(self) -> None:
        """Somebody may have written a request."""
        self._arrived.set()
        self.news.set()

    def stopped(self) -> None:
        """The global stop changed."""
        stop = self._needs.switch.stop
        if stop.active:
            self._signals.end(by=stop.by or "robomend", reason=f"global stop: {stop.reason}", stop=True)
        self.news.set()

    async def run(self) -> None:
        """Go on until it has ended."""
        listener = asyncio.create_task(self._listen(), name=f"requests of {self._record.id}")
        try:
            while self._record.open:
                self._signals = Signals(lambda: self._needs.switch.active)
                self.stopped()
                if self._request is not None:
                    self._hear(self._request)
                try:
                    await self._go_on()
                except Halted:
                    await self._halted()
                except StoreError as error:  # it may come back; what is on disk counts then
                    log.warning("drill", drill=self._record.id, code=error.code, detail=str(error))
                    self._why = f"the store failed in the middle of it: {error}"
                    await asyncio.sleep(LOOK_S)
        finally:
            listener.cancel()
            await asyncio.wait({listener})

    async def _go_on(self) -> None:
        match self._record.state:
            case DrillState.WAITING:
                await self._begin()
            case DrillState.PLANTING | DrillState.PLANTED:
                await self._record.update(DrillTrigger.CUT_SHORT, reason=self._why, cut_short=self._why)
            case DrillState.UNDOING:
                await self._undo()
            case DrillState.RECOVERING:
                await self._recover()
            case DrillState.STOPPED:
                await self._until_lifted()
            case _:
                raise AssertionError(self._record.state)  # run() ends with these

    # --- what is asked of it

    async def _listen(self) -> None:
        """Hand requests from the store to what is under way, for ever."""
        while True:
            self._arrived.clear()
            try:
                asked = await self._record.asked()
                if asked is not None and asked.time_ns > self._heard_ns:
                    self._heard_ns = asked.time_ns
                    self._hear(asked)
            except RobomendError as error:
                log.warning("requests", drill=self._record.id, code=error.code, detail=str(error))
            await wait_for(self._arrived, LOOK_S)

    def _hear(self, asked: DrillRequest) -> None:
        if asked.what == "done":
            self._done.set()
        else:
            self._request = asked
            self._signals.end(by=asked.by, reason=asked.reason or asked.what)
        self.news.set()

    async def _halted(self) -> None:
        """Write what a cancellation, a person's word or the stop makes of it."""
        record, state, asked = self._record, self._record.state, self._request
        stop = self._needs.switch.stop
        by = asked.by if asked is not None else stop.by or "robomend"
        reason = f"{asked.what}: {asked.reason}".rstrip(": ") if asked is not None else ""
        answered = partial(eq, asked)
        if (
            asked is not None
            and asked.what == "abandon"
            and state in {DrillState.UNDOING, DrillState.STOPPED}
        ):
            left = f"{reason}; not undone by robomend: {record.data['undo']}"
            await record.update(DrillTrigger.ABANDONED, reason=left, by=by, answered=answered)
        elif state is DrillState.WAITING:
            why = reason or f"global stop: {stop.reason}"
            await record.update(DrillTrigger.WITHDRAWN, reason=why, by=by, answered=answered, undone=True)
        elif stop.active and state is not DrillState.STOPPED:
            why = f"global stop: {stop.reason}; when it is lifted: {record.data['undo']}"
            cut_short = record.data.get("cut_short") or f"global stop: {stop.reason}"
            await record.update(DrillTrigger.STOPPED, reason=why, by=by, cut_short=cut_short)
        elif asked is not None and state in {DrillState.PLANTING, DrillState.PLANTED}:
            await record.update(
                DrillTrigger.CUT_SHORT, reason=reason, by=by, answered=answered, cut_short=reason
            )
        elif asked is not None:  # too late: it is being undone
            await record.note(answered=answered)
        if self._request is asked:
            self._request = None

    # --- planting, watching

    async def _begin(self) -> None:
        record = self._record
        try:
            if time.time_ns() - record.created_ns > TAKEN_UP_NS:
                raise StateConflict("nobody took it up in time")
            state = await self._state()
            check(state, fault_of(state, record.kind, record.component, record.topic))
            hand = await self._hand(state)
            watching = self._watching(state)
            self._why = "it was cut short in the middle"
            if self._signals.halt.is_set():
                raise Halted
            await record.begin()
        except (InputError, NotFound) as error:
            await record.update(DrillTrigger.NOT_POSSIBLE, reason=str(error), undone=True)
            return
        watching.planted()
        result = await self._signals.unless_halted(hand.plant(f"{record.id}:plant"))
        if result.code in {REFUSED, UNREACHABLE} and record.kind is not FaultKind.UNPLUGGED:
            await record.update(DrillTrigger.NOT_ACTED, reason=result.message, undone=True)
            return
        if not result.ok:
            await record.update(
                DrillTrigger.CUT_SHORT, reason=result.message, cut_short=f"the act failed: {result.message}"
            )
            return
        if record.kind is FaultKind.UNPLUGGED:  # not when a person was asked for it
            watching.planted()
        await record.update(DrillTrigger.ACTED, reason=result.message, planted_ns=time.time_ns())
        try:
            await self._signals.unless_halted(watching.watch())
        except Gone as gone:
            await record.update(
                DrillTrigger.CUT_SHORT, reason=str(gone), cut_short=str(gone), seen=await watching.seen()
            )
            return
        await record.update(DrillTrigger.WATCHED, seen=await watching.seen())

    def _watching(self, state: Robot) -> Watching:
        hold_s = state.config.hold_s
        return Watching(self._needs.store, state, self._record, hold_s=hold_s, news=self.news)

    async def _state(self) -> Robot:
        return await self._needs.robots.diagnosed(self._record.robot)

    async def _hand(self, state: Robot) -> Hand:
        """Return who plants and undoes this fault."""
        record, needs = self._record, self._needs
        parts = state.system.parts
        if parts is None or (record.component is not None and record.component not in parts.components):
            raise NotFound(f"the model of {state.id!r} has no {record.component!r} (any more)")
        device = None if record.component is None else parts.hardware.get(record.component)
        channel = None if device is None else device.channel
        match record.kind:
            case kind if kind in AGENTS_FAULTS:
                bound_s, halt = record.data["bound_s"], self._signals.halt
                # The bus may be another host's: whichever agent has it says so.
                host = parts.nodes[record.component].host if record.component and not record.topic else None
                target = record.topic or str(record.component)
                return AgentsHand(needs.agents, state.id, host, kind, target, bound_s, halt, self._fence)
            case FaultKind.OFF:
                board = await needs.robots.board(state.id)
                if channel is None:
                    raise NotFound(f"{record.component!r} hangs on no channel (any more)")
                return BoardsHand(board, channel, needs.switch, state.interlocked, record.id, self._confirm)
            case FaultKind.UNPLUGGED:
                return PersonsHand(self._until_done, record.data["act"], record.data["undo"])
            case kind:
                config = state.config.board
                if config is None or config.control_port is None:
                    raise NotFound(f"the board of {state.id!r} is not (any more) an emulated one")
                at = (config.host, config.control_port)
                stop = needs.switch
                return EmulatorsHand(*at, EMULATED[kind], channel, stop, state.interlocked, self._confirm)

    async def _until_done(self, what: str) -> bool:
        """Ask a person to do something; return whether they said `done` within the drill's bound."""
        self._done.clear()
        await self._record.note(answered=lambda one: one.what == "done", waiting_for=what)
        await wait_for(self._done, self._record.data["bound_s"])
        return self._done.is_set()

    # --- undoing

    async def _undo(self) -> None:
        record, signals = self._record, self._signals
        await signals.unless_halted(self._end_repairs())
        tries = record.data.get("tries", 0) + 1
        await record.note(tries=tries)
        try:
            state = await self._state()
            hand = await self._hand(state)
            state.sight.start_ups.disturbed()
            result = await signals.unless_halted(hand.undo(f"{record.id}:undo.{tries}"))
            state.sight.start_ups.disturbed()  # what began meanwhile, too
            done, message = result.ok or result.code == UNDONE_BEFORE, result.message
            by_itself = result.code == UNDONE_BEFORE and tries == 1
        except StoreError:
            raise
        except RobomendError as error:
            done, message, by_itself = False, f"{error.code}: {error}", False
        if done:
            cut_short = record.data.get("cut_short") or (
                "the agent undid it by itself: it was restarted, or its lease was over" if by_itself else None
            )
            await record.update(DrillTrigger.UNDONE, reason=message, undone=True, cut_short=cut_short)
            return
        await record.update(DrillTrigger.TRIED_IN_VAIN, reason=f"not undone yet: {message}")
        pause_s = min(0.25 * 2 ** min(tries, 10), LONGEST_PAUSE_S)
        await signals.unless_halted(asyncio.sleep(pause_s))

    async def _end_repairs(self) -> None:
        """See that the repair ends that answers the drill: two hands at one robot are one too many.

        One that is at it may finish its plan: cut off between a stop and a start, it would leave more to be
        brought back.
        """
        record, store = self._record, self._needs.store
        deadline = time.monotonic() + REPAIR_ENDS_S
        patient = True

        def cancel(tx: Transaction) -> bool:
            repair = repair_of(tx, record)
            if repair is None or not repair.open:
                return False
            if patient and repair.state in AT_IT:
                return True
            if not any(r.repair == repair.id for r in repairs.requests(tx, record.robot)):
                why = f"the drill {record.id} is over"
                repairs.ask(tx, repair.id, "cancel", by="robomend", reason=why)
                self._needs.tell_cancelled(tx, repair, why)
            return True

        while await store.write(cancel, robots=(record.robot,)):
            patient = time.monotonic() < deadline
            if time.monotonic() >= deadline + REPAIR_ENDS_S:
                return
            self.news.clear()
            await wait_for(self.news, LOOK_S)

    async def _recover(self) -> None:
        """Wait for the robot to be healthy; bring back what its repair or its power left, if need be."""
        state = await self._state()
        delays = [state.sight.delays(atom).detection_ns / 1e9 for atom in state.sight.observed]
        hold_s = min(max([*delays, HELD_S[0]]), HELD_S[1])
        wait = self._signals.unless_halted
        # What was heard before vouches for nothing: an agent may have been away, or starved, all the while.
        undone_ns, parts, record = CLOCK.now_ns(), state.system.parts, self._record
        taken = frozenset[str]() if parts is None else taken_by(parts, record.kind, record.component)
        unheard = partial(not_heard_since, state, resting_on(state, taken), undone_ns)
        await wait(heard(state, RECOVERED_S, self.news, unheard))
        well = await wait(healthy_for(state, hold_s, 2 * hold_s + 2.0, self.news, unheard))
        if not well:
            await wait(self._bring_back(state))
            well = await wait(healthy_for(state, hold_s, RECOVERED_S, self.news, unheard))
        if not well and (atoms := unheard()):
            why = f"it is undone, and nobody could confirm {named(atoms)} since"
            await record.update(DrillTrigger.NOT_WELL, reason=why)
        elif not well:
            bad = state.current.bad_sets if state.current is not None else None
            what = " or ".join(" with ".join(one) for one in (bad or ())[:5]) or "what is not observed"
            await record.update(
                DrillTrigger.NOT_WELL, reason=f"it is undone, and the robot is not healthy: {what}"
            )
        elif cut_short := record.data.get("cut_short"):
            await record.update(DrillTrigger.WELL_CUT_SHORT, reason=cut_short)
        else:
            await record.update(DrillTrigger.WELL, reason="undone, and the robot is healthy")

    async def _bring_back(self, state: Robot) -> None:
        """Restart the drivers of devices that lost their power by the fault or by its repair: they lost their
        connection. Switch on and start what the repair had switched off or stopped when the drill was over.
        """
        parts, needs, record = state.system.parts, self._needs, self._record
        if parts is None:
            return
        left = await needs.store.read(lambda view: left_off_by(view, record.robot))
        acted = await needs.store.read(lambda view: acted_on_by_repair(view, record))
        taken = taken_by(parts, record.kind, record.component) | acted
        drivers = drivers_of(parts, taken & parts.hardware.keys())
        acts = [("power_up", name) for name in sorted(left & parts.hardware.keys())]
        acts += [("stop_node", name) for name in sorted(drivers)]
        acts += [("start_node", name) for name in sorted(drivers | (left & parts.nodes.keys()))]
        around = Surroundings(
            robot=state.id,
            board=None if state.config.board is None else await needs.robots.board(state.id),
            agents=needs.agents,
            hosts={name: node.host for name, node in parts.nodes.items()},
            programs=needs.settings.programs,
            webhook_hosts=needs.settings.webhook_hosts,
            halt=self._signals.halt,
            confirm=self._confirm,
            fence=self._fence,
        )
        by = executors({name for name, _ in acts}, state.config.actions, around)
        tries = record.data.get("tries", 0) + 1
        await record.note(tries=tries)
        for number, (name, component) in enumerate(acts):
            action = Action(f"{record.id}:back.{tries}.{number}", name, (component,), NODE_S)
            if name in by:
                result = await by[name].execute(action, lambda number, message: None)
                if not result.ok:
                    log.warning("drill", drill=record.id, action=str(action), detail=result.message)

    async def _until_lifted(self) -> None:
        """Wait for the end of the global stop, or for a person's word that nothing is left to be undone."""
        while self._needs.switch.active:
            if self._request is not None:
                raise Halted
            self.news.clear()
            await wait_for(self.news, LOOK_S)
        await self._record.update(DrillTrigger.LIFTED, reason="the global stop is lifted")
