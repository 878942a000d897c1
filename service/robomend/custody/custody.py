"""The repair loops of all robots that this instance owns; what the HTTP interface asks of them.

    orphan or new robot ──► acquire (a fence) ──► Keeper: one task per robot, see robomend.custody.keeper
    event in the log    ──► wakes the keeper that it concerns, whichever instance wrote it

Requests (approve, cancel, a new repair) are written into the store by whichever instance was asked; the event
wakes the owner. So nothing here depends on who owns the robot, except the keepers themselves.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Mapping, Sequence

import structlog

from robomend.custody.choosing import Chooser
from robomend.custody.keeper import Keeper, Tools
from robomend.custody.reentry import open_question
from robomend.errors import Conflict, NotFound, Refused, RobomendError
from robomend.fleet.fleet import Fleet
from robomend.fleet.oneshots import OneShots
from robomend.repair.book import repair_json
from robomend.repair.executors.agent import AgentQueue
from robomend.repair.planner_pool import PlannerPool
from robomend.repair.service_interface import Json, Repairs
from robomend.settings import Settings
from robomend.store.interface import Store, Transaction, View
from robomend.store.records import AuditEntry, Fence, Paging, Repair, Stop
from robomend_client.events import Event, Kind

log = structlog.get_logger("robomend.custody.custody")

ORPHANS_S = 1.0
"""How often robots without an owner are looked for: a dead instance's robots are taken over in about this."""

CLOSE_S = 3.0
"""For the keepers to let go at shutdown."""

DECIDED_S = 1.5
"""How long `approve` and `cancel` wait for the owner, so that their answer shows the effect."""


def make_repairs(
    store: Store, fleet: Fleet, planners: PlannerPool, one_shots: OneShots, settings: Settings
) -> Repairs:
    """Return the repair loops of one instance, over the parts that it has."""
    agents = AgentQueue(store)
    chooser = Chooser(store, planners, one_shots)
    return Custody(Tools(store, fleet, agents, chooser, settings.programs))


class Custody:
    """Implements robomend.repair.service_interface.Repairs. Belongs to one event loop."""

    def __init__(self, tools: Tools) -> None:
        self._tools = tools
        self._store = tools.store
        self._keepers: dict[str, Keeper] = {}
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._stop_changes = 0  # so that what was read before a change does not undo it
        self._look = asyncio.Event()
        self._let_go: set[str] = set()  # robots whose keeper ended: released before they are kept again
        self._seeker: asyncio.Task[None] | None = None
        self._ends: list[Callable[[], None]] = []

    # --- life

    async def start(self) -> None:
        """Take up the work: robots without an owner become ours, with their unfinished repairs."""
        self._tools.agents.start()
        self._ends = [
            self._store.subscribe(self._follow),
            self._store.ownership.on_lost(self._lost),
        ]
        # After following began, so that a stop in between is not missed.
        self._tools.stop = await self._store.read(lambda view: view.stop())
        self._tools.fleet.on_diagnosis(self._poke)
        self._seeker = asyncio.create_task(self._seek(), name="looking for robots without an owner")

    async def close(self) -> None:
        """Let go: nothing more is sent; what runs is cut off and taken up again by the next owner."""
        for end in self._ends:
            end()
        if self._seeker is not None:
            self._seeker.cancel()
        for task in self._tasks.values():
            task.cancel()
        tasks = [*self._tasks.values(), *([self._seeker] if self._seeker else [])]
        if tasks:
            await asyncio.wait(tasks, timeout=CLOSE_S)
        self._tools.agents.close()

    async def _seek(self) -> None:
        """Acquire what nobody owns, again and again; the database may be away for a while."""
        while True:
            self._look.clear()
            try:
                await self._read_stop()
                await self._acquire()
            except RobomendError as error:
                log.warning("looking for robots", code=error.code, detail=str(error))
            except Exception:  # else no robot would ever get a keeper again
                log.exception("looking for robots")
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(ORPHANS_S):
                    await self._look.wait()

    async def _read_stop(self) -> None:
        """Read the global stop, for an event that was lost with its database connection."""
        changes = self._stop_changes
        stop = await self._store.read(lambda view: view.stop())
        if stop.active != self._tools.stop.active and changes == self._stop_changes:
            self._set(stop)

    async def _acquire(self) -> None:
        """Make a keeper for each robot that nobody owns, and for each of ours that has none."""
        ownership = self._store.ownership
        for robot in tuple(self._let_go):
            await ownership.release(robot)
            self._let_go.discard(robot)
        for robot in {*await ownership.orphans(), *ownership.held} - self._keepers.keys():
            with contextlib.suppress(NotFound):  # deleted meanwhile
                fence = await ownership.acquire(robot)
                if fence is not None and robot not in self._keepers:
                    self._keep(robot, fence)

    def _keep(self, robot: str, fence: Fence) -> None:
        keeper = self._keepers[robot] = Keeper(self._tools, robot, fence)
        task = self._tasks[robot] = asyncio.create_task(keeper.run(), name=f"keeper of {robot}")
        task.add_done_callback(lambda _: self._ended(robot, keeper))

    def _ended(self, robot: str, keeper: Keeper) -> None:
        if self._keepers.get(robot) is keeper:
            del self._keepers[robot], self._tasks[robot]
            # The fence may be an old one, of a robot that another instance has or that was deleted.
            self._let_go.add(robot)
            self._look.set()

    def _lost(self, fence: Fence) -> None:
        keeper = self._keepers.get(fence.robot)
        if keeper is not None and keeper.fence == fence:
            self._tasks[fence.robot].cancel()

    def _poke(self, robot: str) -> None:
        keeper = self._keepers.get(robot)
        if keeper is not None:
            keeper.poke()

    def _follow(self, events: Sequence[Event]) -> None:
        for event in events:
            if event.kind is Kind.STOP:
                data = event.data
                self._set(Stop(bool(data.get("active")), data.get("by"), data.get("reason", "")))
            elif event.robot is not None and event.kind in {Kind.REPAIR, Kind.ROBOT, Kind.DIAGNOSIS}:
                if event.kind is Kind.ROBOT and event.data.get("what") == "deleted":
                    task = self._tasks.get(event.robot)
                    if task is not None:
                        task.cancel()
                elif event.robot not in self._keepers:
                    self._look.set()
                elif event.kind is Kind.REPAIR:
                    self._keepers[event.robot].asked()
                elif event.kind is Kind.ROBOT and event.data.get("what") in {"updated", "released"}:
                    self._keepers[event.robot].reconsider()
                else:
                    self._keepers[event.robot].poke()

    def _set(self, stop: Stop) -> None:
        self._stop_changes += 1
        self._tools.stop = stop
        for keeper in self._keepers.values():
            keeper.stopped()

    # --- repairs

    async def plan(
        self, robot: str, *, bad: Sequence[str] | None, planner: str | None, timeout_s: float, pddl: bool
    ) -> Json:
        """Plan without acting: what would be done now?"""
        state = await self._tools.fleet.latest(robot)
        return await self._tools.chooser.describe(
            state, bad=bad, planner=planner, timeout_s=timeout_s, pddl=pddl
        )

    async def create(self, robot: str, *, bad: Sequence[str] | None, by: str, reason: str) -> Json:
        """Begin a repair on request; the owner takes it up."""
        state = await self._tools.fleet.latest(robot)
        if state.config.policy == "observe":
            raise Refused(f"the policy of robot {robot!r} is 'observe': it is never acted on")
        if state.system.parts is None:
            raise Refused(f"the model of robot {robot!r} does not say what could be repaired")
        known = frozenset(state.system.cnf.components)
        for component in bad or ():
            if component not in known:
                raise NotFound(f"the model has no component {component!r}")
        wanted = None if bad is None else list(bad)

        def begin(tx: Transaction) -> Repair:
            stop = tx.stop()  # not as we heard of it: another instance may have lifted it just now
            if stop.active:
                raise Refused(f"the global stop is active, set by {stop.by}: {stop.reason}")
            if tx.repairs(robot, Paging(limit=1), open_only=True).items:
                raise Conflict(f"a repair of robot {robot!r} is open already")
            data = {
                "policy": state.config.policy,
                "by": by,
                "asked": True,
                "wanted": wanted,
                "reason": reason,
                "question": open_question(tx, robot),
            }
            repair = tx.create_repair(robot, state="waiting", data=data)
            tx.emit(Kind.REPAIR, robot, repair_json(repair))
            tx.note(AuditEntry(by, "repair.create", repair.id, robot, reason, after={"bad": wanted}))
            return repair

        return repair_json(await self._store.write(begin, robots=(robot,)))

    async def repairs(self, robot: str, *, before: str | None, limit: int) -> Sequence[Json]:
        """Return repairs, newest first."""

        def look(view: View) -> list[Json]:
            view.robot(robot)
            page = view.repairs(robot, Paging(before, limit))
            return [repair_json(repair, view.steps(repair.id)) for repair in page.items]

        return await self._store.read(look)

    async def repair(self, repair_id: str) -> Json:
        """Return one repair with its steps."""
        return await self._store.read(lambda view: repair_json(view.repair(repair_id), view.steps(repair_id)))

    async def approve(self, repair_id: str, *, by: str, reason: str) -> Json:
        """Let a repair that awaits approval run."""
        return await self._ask(repair_id, "approve", by, reason)

    async def cancel(self, repair_id: str, *, by: str, reason: str) -> Json:
        """End an open repair."""
        return await self._ask(repair_id, "cancel", by, reason)

    async def _ask(self, repair_id: str, what: str, by: str, reason: str) -> Json:
        def ask(tx: Transaction) -> str:
            repair = tx.repair(repair_id)
            if not repair.open:
                raise Conflict(f"repair {repair_id} has ended already ({repair.state})")
            if what == "approve" and repair.state != "awaiting-approval":
                raise Conflict(f"repair {repair_id} awaits no approval; it is {repair.state}")
            if any(r.what == what and r.repair == repair_id for r in tx.repair_requests(repair.robot)):
                raise Conflict(f"repair {repair_id}: somebody said {what!r} already")
            tx.ask(repair_id, what, by=by, reason=reason)
            tx.emit(Kind.REPAIR, repair.robot, {**repair_json(repair), "asked": what, "asked_by": by})
            tx.note(AuditEntry(by, f"repair.{what}", repair_id, repair.robot, reason))
            return repair.state

        before = await self._store.write(ask)
        loop = asyncio.get_running_loop()
        deadline = loop.time() + DECIDED_S
        while True:
            now = await self.repair(repair_id)
            if now["state"] != before and (what == "approve" or now["finished_ns"] is not None):
                return now
            if loop.time() >= deadline:
                return now
            await asyncio.sleep(0.02)

    # --- agents

    def end_waits(self) -> None:
        """Let every waiting agent go with nothing to do: the service shuts down."""
        self._tools.agents.end_waits()

    async def next_action(self, robot: str, *, host: str | None, wait_s: float) -> Json | None:
        """Hand the agent on `host` its next action, waiting up to `wait_s`."""
        await self._tools.fleet.robot(robot)
        action = await self._tools.agents.take(robot, host, wait_s)
        if action is None:
            return None
        return {
            "id": action.id,
            "name": action.name,
            "parameters": list(action.parameters),
            "timeout_s": action.timeout_s,
            "host": action.host,
        }

    async def action_robot(self, action_id: str) -> str:
        """Return the robot that an action belongs to."""
        return await self._store.read(lambda view: view.agent_action(action_id).robot)

    async def feedback(self, action_id: str, *, code: int, message: str, by: str) -> None:
        """Note that an agent has begun."""
        await self._tools.agents.answered(action_id)

    async def result(self, action_id: str, *, code: int, message: str, by: str) -> Json:
        """Take an action's result; a repeated one gets the first."""
        action = await self._tools.agents.finish(action_id, code, message)
        return {"code": action.code, "message": action.message}

    # --- the global stop, quarantine

    async def stopped(self) -> Json:
        """Return the global stop."""
        return _stop_json(await self._store.read(lambda view: view.stop()))

    async def stop(self, *, by: str, reason: str) -> Json:
        """No action starts anywhere, and running ones are cancelled."""
        return await self._set_stop(True, by, reason)

    async def resume(self, *, by: str, reason: str) -> Json:
        """Lift the global stop."""
        return await self._set_stop(False, by, reason)

    async def _set_stop(self, active: bool, by: str, reason: str) -> Json:
        if active:  # here at once, before it is on disk; other instances hear of it by the event
            self._set(Stop(True, by, reason))

        def change(tx: Transaction) -> Stop:
            stop = tx.set_stop(active, by=by, reason=reason)
            tx.emit(Kind.STOP, None, _stop_json(stop))
            tx.note(AuditEntry(by, "stop.set" if active else "stop.lifted", "all robots", None, reason))
            return stop

        try:
            stop = await self._store.write(change)
        finally:
            self._stop_changes += 1
        self._set(stop)
        return _stop_json(stop)

    async def quarantined(self, robot: str) -> Mapping[str, str]:
        """Return component -> why it is not tried again."""
        entries = await self._store.read(lambda view: view.quarantine(robot))
        return {entry.component: entry.reason for entry in entries}

    async def release(self, robot: str, component: str, *, by: str, reason: str) -> None:
        """Let a quarantined component be tried again."""

        def let_go(tx: Transaction) -> None:
            tx.release_quarantine(robot, component)
            tx.forget_tried(robot, component)
            tx.emit(Kind.ROBOT, robot, {"what": "released", "component": component, "by": by})
            tx.note(AuditEntry(by, "quarantine.release", component, robot, reason))

        await self._store.write(let_go, robots=(robot,))


def _stop_json(stop: Stop) -> dict[str, object]:
    return {"active": stop.active, "by": stop.by, "reason": stop.reason, "since_ns": stop.since_ns}
