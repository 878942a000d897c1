"""The drills of all robots that this instance owns; what the HTTP interface asks of them.

Requests are written into the store by whichever instance was asked; the event wakes the owner. Owning is the
repairs' business (robomend.repairs.repairs): a drill is carried out by the owner of its robot, under the same
fence.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Any

import structlog

from robomend.drills.one_drill import DrillNeeds, OneDrill
from robomend.drills.permission import check, fault_of
from robomend.drills.record import DrillState, drill_json, new_drill
from robomend.errors import InputError, RobomendError, StateConflict
from robomend.planning.faults import FaultKind
from robomend.poller import Seeker
from robomend.store import Transaction, View, drills, global_stop, robots
from robomend.store.records import AuditEntry, Fence, Json, Paging, StoredDrill
from robomend_client.events import Event, Kind

log = structlog.get_logger("robomend.drills.drills")

LOOK_S = 1.0
"""How often open drills are looked for that nobody carries out: after a restart, after another instance."""

CLOSE_S = 3.0

DECISIONS = {
    "cancel": (DrillState.WAITING, DrillState.PLANTING, DrillState.PLANTED),
    "done": (DrillState.PLANTING, DrillState.UNDOING),
    "abandon": (DrillState.UNDOING, DrillState.STOPPED),
}
"""What a person may say of a drill, and in which states: `abandon` leaves the fault to them."""


class Drills:
    """See the module. Belongs to one event loop."""

    def __init__(self, needs: DrillNeeds) -> None:
        self._needs = needs
        self._store = needs.store
        self._running: dict[str, tuple[OneDrill, Fence, asyncio.Task[None]]] = {}  # by robot
        self._seeker = Seeker(self._take_up, "open drills", LOOK_S)
        self._ends: list[Callable[[], None]] = []

    async def start(self) -> None:
        """Take up what a crash left, and what is asked for from now on."""
        self._ends = [
            self._store.subscribe(self._follow, (Kind.DRILL, Kind.DIAGNOSIS, Kind.REPAIR)),
            self._store.ownership.on_lost(self._lost),
        ]
        self._needs.switch.on_change(self._stop_changed)
        self._seeker.start()

    async def close(self) -> None:
        """Let go; what is open is taken up by whoever owns the robot next."""
        for end in self._ends:
            end()
        await self._seeker.close([task for _, _, task in self._running.values()], CLOSE_S)

    async def _take_up(self) -> None:
        """Carry out what is open on our robots and nobody is at."""
        for drill in await self._store.read(drills.open_ones):
            fence = self._store.ownership.held.get(drill.robot)
            if fence is not None and drill.robot not in self._running:
                self._carry_out(drill, fence)

    def _carry_out(self, drill: StoredDrill, fence: Fence) -> None:
        one = OneDrill(self._needs, drill, fence)
        task = asyncio.create_task(self._run(one, drill), name=f"drill {drill.id}")
        self._running[drill.robot] = (one, fence, task)
        task.add_done_callback(lambda _: self._ended(drill.robot, one))

    async def _run(self, one: OneDrill, drill: StoredDrill) -> None:
        try:
            await one.run()
        except RobomendError as error:  # fenced: another instance has it; else it is taken up again
            log.warning("drill", drill=drill.id, code=error.code, detail=str(error))
            await asyncio.sleep(LOOK_S)
        except Exception:  # a fault of ours must not leave the fault planted
            log.exception("drill", drill=drill.id)
            await asyncio.sleep(LOOK_S)

    def _ended(self, robot: str, one: OneDrill) -> None:
        found = self._running.get(robot)
        if found is not None and found[0] is one:
            del self._running[robot]
            self._seeker.wake()

    def _lost(self, fence: Fence) -> None:
        found = self._running.get(fence.robot)
        if found is not None and found[1] == fence:
            found[2].cancel()

    def _stop_changed(self) -> None:
        for one, _, _ in self._running.values():
            one.stopped()

    def _follow(self, events: Sequence[Event]) -> None:
        for event in events:
            found = self._running.get(event.robot or "")
            if event.kind is Kind.DRILL:
                if found is None:
                    self._seeker.wake()
                else:
                    found[0].asked()
            elif found is not None and event.kind in {Kind.DIAGNOSIS, Kind.REPAIR}:
                found[0].news.set()

    # --- for HTTP

    async def create(
        self,
        robot: str,
        *,
        fault: str,
        component: str | None,
        topic: str | None,
        bound_s: float,
        detect_s: float,
        by: str,
        reason: str,
    ) -> Json:
        """Plant a fault on a robot, watch it and undo it; see `check` for what is refused."""
        try:
            kind = FaultKind(fault)
        except ValueError:
            known = ", ".join(FaultKind)
            raise InputError(f"there is no fault {fault!r}; there are {known}") from None
        state = await self._needs.robots.diagnosed(robot)
        found = fault_of(state, kind, component, topic)
        check(state, found)

        def begin(tx: Transaction) -> StoredDrill:
            stop = global_stop.hold(tx) if self._needs.switch.settled else self._needs.switch.stop
            if stop.active:
                raise StateConflict(f"the global stop is active, set by {stop.by}: {stop.reason}")
            return new_drill(tx, robot, found, bound_s=bound_s, detect_s=detect_s, by=by, reason=reason)

        return drill_json(await self._store.write(begin, robots=(robot,)))

    async def drills(self, robot: str, *, before: str | None, limit: int) -> Sequence[Json]:
        """Return up to `limit` drills of the robot, newest first, older than the drill `before`."""

        def look(view: View) -> list[Json]:
            robots.get(view, robot)
            return [drill_json(drill) for drill in drills.page(view, robot, Paging(before, limit)).items]

        return await self._store.read(look)

    async def drill(self, drill: str) -> Json:
        """Return one drill."""
        return drill_json(await self._store.read(drills.get, drill))

    async def open_of(self, robot: str) -> Json | None:
        """Return the robot's open drill, if it has one."""
        found = await self._store.read(drills.open_of, robot)
        return None if found is None else drill_json(found)

    async def decide(self, drill: str, what: str, *, by: str, reason: str) -> Json:
        """Say something about an open drill: see DECISIONS. StateConflict in other states."""

        def ask(tx: Transaction) -> dict[str, Any]:
            found = drills.get(tx, drill)
            if found.state not in DECISIONS[what]:
                raise StateConflict(f"drill {drill} is {found.state}: there is nothing to {what}")
            if what == "done" and found.data.get("waiting_for") is None:
                raise StateConflict(f"drill {drill} waits for nobody")
            asked = drills.ask(tx, drill, what, by=by, reason=reason)
            told = {**drill_json(asked), "asked": what, "asked_by": by}
            tx.emit(Kind.DRILL, asked.robot, told)
            tx.note(AuditEntry(by, f"drill.{what}", drill, asked.robot, reason))
            return told

        return await self._store.write(ask)
