"""What the HTTP interface asks of the repairs: plans, approvals, the global stop, and what agents say.

Requests (approve, cancel, a new repair) are written into the store by whichever instance was asked; the event
wakes the owner's loop (robot_repairs.py). So nothing here depends on who owns the robot.

Every mapping that comes back holds JSON values only and is served as it is, in the literature's words:

    repair      {"id", "robot", "state", "policy", "round", "diagnosis": {"bad", "good"} | null,
                 "plan": [step…], "cost", "assumed": [literal…], "waiting_for": [literal…], "reason", "by",
                 "created_ns", "updated_ns", "finished_ns" | null, and the same in RFC 3339}
    step        {"index", "name", "parameters", "after", "cost", "state", "result" | null, "message",
                 "feedback": {"code", "message", "time_ns"} | null}
    action      {"id", "name", "parameters", "timeout_s", "host" | null}

Errors are those of robomend.errors: NotFound (no such robot, repair or action), StateConflict (not
in the state that the request needs), Refused (policy, protection, stop), and the backends' own.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from robomend.errors import NotFound, Refused, RobomendError, StateConflict
from robomend.oneshots.oneshots import OneShots
from robomend.planning.planner_pool import PlannerPool
from robomend.repairs.account import account
from robomend.repairs.agent_queue import AgentQueue
from robomend.repairs.choosing import Chooser, offers_now
from robomend.repairs.dependencies import Dependencies
from robomend.repairs.executors.registry import Surroundings, check
from robomend.repairs.foresight import Asked, findings
from robomend.repairs.record import new_repair
from robomend.repairs.repair_json import change_json, repair_json
from robomend.repairs.robot_repairs import RobotLoops
from robomend.repairs.states import RepairState
from robomend.repairs.stop_switch import StopSwitch, written
from robomend.robots import configuring
from robomend.robots.boards import WiredBoard
from robomend.robots.declared import HEARD_S, declaration
from robomend.robots.reporters import OURSELVES, Reporter
from robomend.robots.robots import Robots
from robomend.settings import Settings
from robomend.store import (
    Store,
    Transaction,
    View,
    agent_actions,
    attempts,
    drills,
    global_stop,
    repairs,
    robots,
)
from robomend.store.records import AuditEntry, Json, Paging, Quarantine, StoredRepair
from robomend_client.events import Kind

DECIDED_S = 1.5
"""How long `approve` and `cancel` wait for the owner, so that their answer shows the effect."""


def make_repairs(
    store: Store, robots: Robots, planners: PlannerPool, one_shots: OneShots, settings: Settings
) -> Repairs:
    """Return the repair loops of one instance, over the parts that it has."""
    switch = StopSwitch(store)
    agents = AgentQueue(store, lambda: switch.active)
    chooser = Chooser(store, planners, one_shots, robots.readers)
    return Repairs(Dependencies(store, robots, agents, chooser, switch, settings))


class Repairs:
    """What the routers ask of the repair loops. Belongs to one event loop."""

    def __init__(self, needs: Dependencies) -> None:
        self._needs = needs
        self._store = needs.store
        self.switch = needs.switch
        self.agents = needs.agents
        self._loops = RobotLoops(needs)

    # --- life

    async def start(self) -> None:
        """Take up the work: re-enter unfinished repairs from the journal. Called once, before serving."""
        self._needs.agents.start()
        await self._loops.start()

    async def close(self) -> None:
        """Let go within a few seconds: running actions are cancelled, journals closed, workers ended."""
        await self._loops.close()
        await self.switch.close()
        await self._needs.agents.close()

    # --- repairs

    def check_actions(self, robot: str, configured: Mapping[str, Mapping[str, Any]]) -> None:
        """Refuse (InputError) the `actions` of a robot's configuration that cannot work."""
        check(configured, self._around(robot, None))

    def _around(self, robot: str, board: WiredBoard | None) -> Surroundings:
        """Return what executors are made with to see whether they can be; nothing is carried out with it."""
        return self._needs.around(robot, board, {}, asyncio.Event())

    async def plan(
        self, robot: str, *, bad: Sequence[str] | None, planner: str | None, timeout_s: float, pddl: bool
    ) -> Json:
        """Plan without acting: for the diagnosis `bad`, or for the best choice now when it is None.

        Returns {"choice": {"bad", "good", "probability"}, "plan": a Plan as JSON, "alternatives": […],
        "probe": … | null}.
        """
        state = await self._needs.robots.memory.latest(robot)
        return await self._needs.chooser.describe(
            state, bad=bad, planner=planner, timeout_s=timeout_s, pddl=pddl
        )

    async def findings(self, robot: str) -> Sequence[str]:
        """Return what will not work or not be noticed on a robot, in sentences (foresight.py)."""
        needs = self._needs
        state = await needs.robots.memory.robot(robot)
        board = None if state.config.board is None else await needs.robots.board(robot)
        faults = await configuring.faults(state.config, state.system, needs.robots.models.readers)
        actions: Sequence[str] = ()
        with contextlib.suppress(RobomendError):  # its domain is at fault: named already
            actions = await needs.chooser.actions(state)
        hosts = [agent.host for agent in state.sight.declared.agents()]
        parts = state.system.parts
        actions = (*actions, *(() if parts is None else parts.acts))
        offers = None if parts is None else await offers_now(state, parts, actions, self._store)
        asked = Asked(hosts, HEARD_S, offers)
        return findings(state, faults, actions, self._around(robot, board), asked)

    async def create(self, robot: str, *, bad: Sequence[str] | None, by: str, reason: str) -> Json:
        """Begin a repair on request. StateConflict if one is open.

        Under the policy `approve` the asker's word is no approval: it must still be approved.
        """
        state = await self._needs.robots.memory.latest(robot)
        if state.config.policy == "observe":
            raise Refused(f"the policy of robot {robot!r} is 'observe': it is never acted on")
        if state.system.parts is None:
            raise Refused(f"the model of robot {robot!r} does not say what could be repaired")
        known = frozenset(state.system.cnf.components)
        for component in bad or ():
            if component not in known:
                raise NotFound(f"the model has no component {component!r}")

        def begin(tx: Transaction) -> StoredRepair:
            # As it is on disk, where another instance may have lifted it just now; or ours, on its way there.
            stop = global_stop.hold(tx) if self.switch.settled else self.switch.stop
            if stop.active:
                raise Refused(f"the global stop is active, set by {stop.by}: {stop.reason}")
            if repairs.page(tx, robot, Paging(limit=1), open_only=True).items:
                raise StateConflict(f"a repair of robot {robot!r} is open already")
            drill = drills.open_of(tx, robot)
            if drill is not None and not drill.watched:
                raise StateConflict(f"drill {drill.id} of robot {robot!r} is {drill.state}; wait for its end")
            policy = state.config.policy
            return new_repair(tx, robot, policy, by=by, reason=reason, asked=True, wanted=bad)

        return repair_json(await self._store.write(begin, robots=(robot,)))

    async def repairs(
        self,
        robot: str,
        *,
        before: str | None,
        limit: int,
        state: str | None = None,
        since_ns: int | None = None,
        until_ns: int | None = None,
    ) -> Sequence[Json]:
        """Return up to `limit` repairs of the robot, newest first, older than the repair `before`; of one
        state, or begun in a span of time, if asked for.
        """
        paging = Paging(before, limit, since_ns, until_ns)

        def look(view: View) -> list[Json]:
            robots.get(view, robot)
            page = repairs.page(view, robot, paging, state=state)
            return [repair_json(repair, repairs.steps(view, repair.id)) for repair in page.items]

        return await self._store.read(look)

    async def repair(self, repair_id: str) -> Json:
        """Return one repair with its steps, and its account."""
        repair = await self._store.read(
            lambda view: repair_json(repairs.get(view, repair_id), repairs.steps(view, repair_id))
        )
        return {**repair, "account": account(repair)}

    async def change(self, change_id: str) -> Json:
        """Return one change of configuration with its steps."""
        return await self._store.read(
            lambda view: change_json(repairs.get(view, change_id), repairs.steps(view, change_id))
        )

    async def approve(self, repair_id: str, *, by: str, reason: str) -> Json:
        """Let a repair that awaits approval run. StateConflict in any other state."""
        return await self._ask(repair_id, "approve", by, reason)

    async def cancel(self, repair_id: str, *, by: str, reason: str) -> Json:
        """End an open repair; running actions are cancelled. StateConflict if it has ended already."""
        return await self._ask(repair_id, "cancel", by, reason)

    async def _ask(self, repair_id: str, what: str, by: str, reason: str) -> Json:
        def ask(tx: Transaction) -> str:
            repair, change = repairs.get(tx, repair_id), repairs.is_change(repair_id)
            kind = "change" if change else "repair"
            if not repair.open:
                raise StateConflict(f"{kind} {repair_id} has ended already ({repair.state})")
            if what == "approve" and repair.state != RepairState.AWAITING_APPROVAL:
                raise StateConflict(f"{kind} {repair_id} awaits no approval; it is {repair.state}")
            if any(r.what == what and r.repair == repair_id for r in repairs.requests(tx, repair.robot)):
                raise StateConflict(f"{kind} {repair_id}: somebody said {what!r} already")
            repairs.ask(tx, repair_id, what, by=by, reason=reason)
            shown = change_json(repair) if change else repair_json(repair)
            tx.emit(
                Kind.CONFIGURATION if change else Kind.REPAIR,
                repair.robot,
                {**shown, "asked": what, "asked_by": by},
            )
            tx.note(AuditEntry(by, f"{kind}.{what}", repair_id, repair.robot, reason))
            return repair.state

        before = await self._store.write(ask)
        loop = asyncio.get_running_loop()
        deadline = loop.time() + DECIDED_S
        while True:
            now = await (self.change if repairs.is_change(repair_id) else self.repair)(repair_id)
            if now["state"] != before and (what == "approve" or now["finished_ns"] is not None):
                return now
            if loop.time() >= deadline:
                return now
            await asyncio.sleep(0.02)

    # --- agents

    def end_waits(self) -> None:
        """Let every waiting agent go with nothing to do: the service shuts down."""
        self._needs.agents.end_waits()

    async def orders(
        self,
        robot: str,
        *,
        host: str | None,
        wait_s: float,
        by: Reporter = OURSELVES,
        agent: str | None = None,
        can: Collection[str] | None = None,
        observes: Mapping[str, tuple[float, float]] | None = None,
        settled: int | None = None,
        takes_s: Mapping[str, float] | None = None,
        starved_ns: int | None = None,
    ) -> Json | None:
        """Hand an agent its next action, waiting up to `wait_s`, and what it is to judge anew.

        `host` decides who gets an action, and `can` what an agent is handed (store/agent_actions.py).

        An action is handed out again until its first feedback or result comes in, so that an answer lost on
        the way loses no action; the agent knows an id that it has had.

        Args:
            agent: its name; None: it says nothing of itself.
            can: the actions that it can do, as `name` or `name:parameter,parameter`; None: it does not say.
            observes: atom -> seconds of detection and of settling.
            takes_s: action, as in `can` -> within how many seconds it answers.
            settled: the latest settle number that it acted on.
            starved_ns: since when its computer is starved.
        """
        state = await self._needs.robots.memory.robot(robot)
        atoms = observes or {}
        who = agent or host or "agent"
        before = state.sight.declared.changes
        said = declaration(who, host, can, atoms, state.system.vocabulary, takes_s, starved_ns)
        state.sight.declared.hear(said)
        if state.sight.declared.changes != before:
            self._loops.wake(robot)
        agents = self._needs.agents
        action = await agents.take(
            robot,
            host,
            wait_s,
            by,
            lambda: agents.settle(robot, settled, atoms.keys()),
            state.interlocked,
            agent=agent,
            can=None if can is None else frozenset(can),
        )
        found: Json = {}
        if action is not None:
            found = {
                "id": action.id,
                "name": action.name,
                "parameters": list(action.parameters),
                "timeout_s": action.timeout_s,
                "host": action.host,
            }
        anew = agents.settle(robot, settled, atoms.keys())
        if anew is not None:
            found = {**found, "settle": {"n": anew.n, "atoms": list(anew.atoms)}}
        return found or None

    async def action_robot(self, action_id: str) -> str:
        """Return the robot that an action belongs to, so that a robot's key opens its own actions only."""
        return await self._store.read(lambda view: agent_actions.get(view, action_id).robot)

    async def feedback(self, action_id: str, *, code: int, message: str) -> None:
        """Note how far an action is, for its step and whoever watches; after its result a StateConflict."""
        await self._needs.agents.feedback(action_id, code, message)

    async def result(self, action_id: str, *, code: int, message: str, by: Reporter) -> Json:
        """Take an action's result; a repeated one is answered with the first: {"code", "message"}."""
        action = await self._needs.agents.finish(action_id, code, message, by)
        return {"code": action.code, "message": action.message}

    # --- the global stop, quarantine

    async def stopped(self) -> Json:
        """Return {"active", "by", "reason", "since_ns", "written", "detail"}."""
        await self.switch.look()
        return self.switch.json(written=self.switch.settled)

    async def stop(self, *, by: str, reason: str) -> Json:
        """The global stop: no action starts anywhere and running ones are cancelled. Survives a restart."""
        return await self._change_stop(True, by, reason)

    async def resume(self, *, by: str, reason: str) -> Json:
        """Lift the global stop."""
        return await self._change_stop(False, by, reason)

    async def _change_stop(self, active: bool, by: str, reason: str) -> Json:
        change = self.switch.ask(active, by=by, reason=reason)
        return self.switch.json(written=await written(change, None))

    async def quarantined(self, robot: str) -> Mapping[str, Quarantine]:
        """Return the components that are not tried again now."""
        entries, now_ns = await self._store.read(attempts.quarantine, robot), time.time_ns()
        return {entry.component: entry for entry in entries if not entry.over(now_ns)}

    async def release(self, robot: str, component: str, *, by: str, reason: str) -> None:
        """Let a quarantined component be tried again. NotFound if it is not in quarantine."""

        def let_go(tx: Transaction) -> None:
            attempts.release_quarantine(tx, robot, component)
            attempts.forget(tx, robot, component)
            tx.emit(Kind.ROBOT, robot, {"what": "released", "component": component, "by": by})
            tx.note(AuditEntry(by, "quarantine.release", component, robot, reason))

        await self._store.write(let_go, robots=(robot,))
