"""The states of a drill, and what is written of it: its state, its undo before the act, what was seen.

Each write is one transaction, with its event and its audit entry, under the fence of the robot's owner.

docs/drill.md draws the table of states. What was planted is undone on every way to an end but one: a
person says to leave it.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from typing import Any

from robomend.errors import StateConflict
from robomend.planning.faults import BY, FaultKind, Plantable, fault_name
from robomend.store import Store, Transaction, drills, global_stop, repairs
from robomend.store.records import AuditEntry, DrillRequest, Fence, Json, Paging, StoredDrill
from robomend.transitions import after
from robomend_client.events import Kind


class DrillState(StrEnum):
    """What a drill is in."""

    WAITING = "waiting"  # for its owner; nothing is planted
    PLANTING = "planting"  # its undo is on disk, the act is sent
    PLANTED = "planted"  # watched; repairs may answer it
    UNDOING = "undoing"
    RECOVERING = "recovering"  # undone; the robot must be seen to be healthy
    STOPPED = "stopped"  # by the global stop, which forbids the undo too; it is due when the stop is lifted
    DONE = "done"  # watched to its end, and undone
    CANCELLED = "cancelled"  # cut short, and undone
    REFUSED = "refused"  # nothing was planted
    FAILED = "failed"  # a person is needed


ENDS = frozenset({DrillState.DONE, DrillState.CANCELLED, DrillState.REFUSED, DrillState.FAILED})
"""Nothing is left of a drill but, where it failed, what its reason says."""

OPEN = tuple(state for state in DrillState if state not in ENDS)
"""A robot has one such drill at a time."""

MAYBE_PLANTED = (DrillState.PLANTING, DrillState.PLANTED, DrillState.UNDOING, DrillState.RECOVERING)


class DrillTrigger(StrEnum):
    """What happens to a drill."""

    BEGUN = "the robot is as it must be; the undo is written down"
    NOT_POSSIBLE = "the robot is in use, or not as it must be"
    WITHDRAWN = "cancelled, or the global stop, before anything was planted"
    ACTED = "the fault is there"
    NOT_ACTED = "who should act says that nothing was done"
    WATCHED = "what becomes of it was seen, or its time is over"
    CUT_SHORT = "the act failed, it was cancelled, the service was restarted, or the agent is gone"
    STOPPED = "the global stop"
    LIFTED = "the stop is lifted"
    TRIED_IN_VAIN = "the undo did not work, and is tried again"
    UNDONE = "what was planted is undone"
    WELL = "the robot is healthy"
    WELL_CUT_SHORT = "the robot is healthy, and the drill was cut short"
    NOT_WELL = "it is undone, and the robot is not healthy"
    ABANDONED = "a person says that nothing more is to be undone"


INITIAL = DrillState.WAITING

DRILL: dict[tuple[DrillState, DrillTrigger], DrillState] = {
    (DrillState.WAITING, DrillTrigger.BEGUN): DrillState.PLANTING,
    (DrillState.WAITING, DrillTrigger.NOT_POSSIBLE): DrillState.REFUSED,
    (DrillState.WAITING, DrillTrigger.WITHDRAWN): DrillState.CANCELLED,
    (DrillState.PLANTING, DrillTrigger.ACTED): DrillState.PLANTED,
    (DrillState.PLANTING, DrillTrigger.NOT_ACTED): DrillState.REFUSED,
    (DrillState.PLANTING, DrillTrigger.CUT_SHORT): DrillState.UNDOING,
    (DrillState.PLANTED, DrillTrigger.WATCHED): DrillState.UNDOING,
    (DrillState.PLANTED, DrillTrigger.CUT_SHORT): DrillState.UNDOING,
    (DrillState.UNDOING, DrillTrigger.TRIED_IN_VAIN): DrillState.UNDOING,
    (DrillState.UNDOING, DrillTrigger.UNDONE): DrillState.RECOVERING,
    (DrillState.UNDOING, DrillTrigger.ABANDONED): DrillState.FAILED,
    (DrillState.RECOVERING, DrillTrigger.WELL): DrillState.DONE,
    (DrillState.RECOVERING, DrillTrigger.WELL_CUT_SHORT): DrillState.CANCELLED,
    (DrillState.RECOVERING, DrillTrigger.NOT_WELL): DrillState.FAILED,
    **{(state, DrillTrigger.STOPPED): DrillState.STOPPED for state in MAYBE_PLANTED},
    (DrillState.STOPPED, DrillTrigger.LIFTED): DrillState.UNDOING,
    (DrillState.STOPPED, DrillTrigger.ABANDONED): DrillState.FAILED,
}


LOOP = "robomend"


def drill_json(drill: StoredDrill) -> dict[str, Any]:
    """Return a drill as HTTP and events show it."""
    data = drill.data
    return {
        "id": drill.id,
        "robot": drill.robot,
        "state": drill.state,
        "fault": data["fault"],
        "component": data["component"],
        "topic": data.get("topic"),
        "planted_by": data["planted_by"],
        "act": data["act"],
        "undo": data["undo"],
        "undone": bool(data.get("undone")),
        "bound_s": data["bound_s"],
        "detect_s": data["detect_s"],
        "waiting_for": data.get("waiting_for"),
        "cut_short": data.get("cut_short"),
        "seen": data.get("seen"),
        "reason": data.get("reason", ""),
        "by": data["by"],
        "planted_ns": data.get("planted_ns"),
        "created_ns": drill.created_ns,
        "updated_ns": drill.updated_ns,
        "finished_ns": None if drill.open else drill.updated_ns,
    }


def new_drill(
    tx: Transaction, robot: str, fault: Plantable, *, bound_s: float, detect_s: float, by: str, reason: str
) -> StoredDrill:
    """Write a new drill; StateConflict while a repair or another drill is open."""
    open_repair(tx, robot)
    data = {
        "fault": str(fault.kind),
        "component": fault.component,
        "topic": fault.topic,
        "planted_by": BY[fault.kind],
        "act": fault.act,
        "undo": fault.undo,
        "bound_s": bound_s,
        "detect_s": detect_s,
        "by": by,
        "asked_for": reason,
        "reason": reason,
    }
    drill = drills.create(tx, robot, state=DrillState.WAITING, data=data)
    tx.emit(Kind.DRILL, robot, drill_json(drill))
    tx.note(AuditEntry(by, "drill.create", drill.id, robot, reason, after={"fault": _named(data)}))
    return drill


def open_repair(tx: Transaction, robot: str) -> None:
    """Refuse (StateConflict) while a repair of the robot is open."""
    found = repairs.page(tx, robot, Paging(limit=1), open_only=True).items
    if found:
        raise StateConflict(f"the robot is in use: repair {found[0].id} is {found[0].state}")


class DrillRecord:
    """The records of one open drill."""

    def __init__(self, store: Store, drill: StoredDrill, fence: Fence) -> None:
        self._store = store
        self._fence = fence
        self._drill = drill

    @property
    def id(self) -> str:
        """The drill's id."""
        return self._drill.id

    @property
    def robot(self) -> str:
        """The robot."""
        return self._drill.robot

    @property
    def state(self) -> DrillState:
        """What the drill is in."""
        return DrillState(self._drill.state)

    @property
    def open(self) -> bool:
        """Whether something is still to be done."""
        return self._drill.open

    @property
    def data(self) -> Json:
        """What is written of it besides its state."""
        return self._drill.data

    @property
    def kind(self) -> FaultKind:
        """The fault."""
        return FaultKind(self.data["fault"])

    @property
    def component(self) -> str | None:
        """What is made faulty; None: nothing that the model knows."""
        component: str | None = self.data["component"]
        return component

    @property
    def topic(self) -> str | None:
        """The topic that is disturbed."""
        topic: str | None = self.data.get("topic")
        return topic

    @property
    def created_ns(self) -> int:
        """When somebody asked for it."""
        return self._drill.created_ns

    async def asked(self) -> DrillRequest | None:
        """Return what is asked of it now."""
        return (await self._store.read(drills.get, self.id)).asked

    async def begin(self) -> None:
        """Write the undo down, before the act; refuse (StateConflict) in a robot that is in use by now."""

        def check(tx: Transaction) -> None:
            stop = global_stop.hold(tx)
            if stop.active:
                raise StateConflict(f"the global stop is active, set by {stop.by}: {stop.reason}")
            open_repair(tx, self.robot)

        await self.update(DrillTrigger.BEGUN, also=check, undone=False)

    async def update(
        self,
        what: DrillTrigger,
        *,
        reason: str = "",
        by: str = LOOP,
        answered: Callable[[DrillRequest], bool] | None = None,
        also: Callable[[Transaction], None] | None = None,
        **changes: Any,
    ) -> None:
        """Note what happened and the state after it.

        Args:
            answered: whether a request is done with; a newer one may be there by now.
            also: what the same transaction does first; where it raises, nothing is written.
        """
        before = self.state
        state = after(DRILL, before, what)
        data = {**self.data, "waiting_for": None, **changes, "reason": reason}
        entry = AuditEntry(
            actor=by,
            action=f"drill.{state}",
            subject=self.id,
            robot=self.robot,
            reason=reason or str(what),
            before={"state": str(before)},
            after={"state": str(state), "fault": _named(data), "undo": data["undo"]},
        )

        def write(tx: Transaction) -> StoredDrill:
            if also is not None:
                also(tx)
            updated = drills.update(
                tx,
                self.id,
                state=state,
                data=data,
                open=state not in ENDS,
                watched=state is DrillState.PLANTED,
                fence=self._fence,
                answered=answered,
            )
            tx.emit(Kind.DRILL, self.robot, drill_json(updated))
            tx.note(entry)
            return updated

        self._drill = await self._store.write(write, robots=(self.robot,))

    async def note(self, *, answered: Callable[[DrillRequest], bool] | None = None, **changes: Any) -> None:
        """Write something down that changes no state."""
        data = {**self.data, **changes}

        def write(tx: Transaction) -> StoredDrill:
            drill = self._drill
            updated = drills.update(
                tx,
                self.id,
                state=drill.state,
                data=data,
                open=drill.open,
                watched=drill.watched,
                fence=self._fence,
                answered=answered,
            )
            tx.emit(Kind.DRILL, self.robot, drill_json(updated))
            return updated

        self._drill = await self._store.write(write, robots=(self.robot,))


def _named(data: Json) -> str:
    return fault_name(data["fault"], data["component"], data.get("topic"))
