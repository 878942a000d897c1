"""What is written of a change of a robot's configuration, and of one for the worse until it is undone.

    due ──► begin ──► note: running, changed, failed ──► is_held: why it is not undone ──► came_back

As of repairs (robomend.repairs.record), one write is one transaction, with the event and the audit entry that
tell of it, and carries the fence of the robot's owner.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from robomend.model.components import Function
from robomend.planning.configurations import VariantChange, held_back
from robomend.planning.plan import Plan
from robomend.repairs.record import LOOP, ActionRecord
from robomend.repairs.repair_json import change_json, plan_json
from robomend.repairs.states import CHANGE, ChangeState, ChangeTrigger
from robomend.robots.robot import Robot
from robomend.store import Store, Transaction, View, drills, global_stop, repairs
from robomend.store.records import AuditEntry, Fence, Paging, StoredRepair
from robomend.transitions import after
from robomend_client.events import Kind

RECALLED = 200
"""Changes that are looked at, at most: after a restart, and for what is not undone."""


class ChangeRecord(ActionRecord):
    """The record of one change, of one function or of several that depend on each other."""

    @property
    def state(self) -> ChangeState:
        """What the change is in."""
        return ChangeState(self._repair.state)

    async def note(
        self,
        what: ChangeTrigger,
        reason: str,
        *,
        by: str = LOOP,
        answers: Sequence[int] = (),
        also: Callable[[Transaction], None] | None = None,
        **changes: Any,
    ) -> None:
        """Note what happened and the state after it, with the event and the audit entry that tell of it."""
        state = after(CHANGE, self.state, what)
        data = {**self._data, **changes, "reason": reason}

        def write(tx: Transaction) -> StoredRepair:
            open_ = state in {ChangeState.AWAITING_APPROVAL, ChangeState.RUNNING}
            updated = repairs.update(tx, self.id, state=state, data=data, open=open_, fence=self.fence)
            _tell(tx, updated, by, reason)
            for request in answers:
                repairs.answer(tx, request, fence=self.fence)
            if also is not None:
                also(tx)
            return updated

        self._data = data
        self._repair = await self._store.write(write, robots=(self.robot,))


async def begin(
    store: Store,
    fence: Fence,
    state: Robot,
    due: Sequence[VariantChange],
    plan: Plan | None = None,
    *,
    asks: bool = False,
) -> ChangeRecord | None:
    """Write a change; None: it may not be begun now."""
    functions = state.functions
    data = {
        "changes": [_to_json(one) for one in due],
        "plan": [] if plan is None else plan_json(plan, 0, state.system.parts, state.sight.entries()),
        "cost": None if plan is None else plan.cost,
        "reason": "; ".join(dict.fromkeys(one.reason for one in due)),
        "by": LOOP,
        "notify": any(functions[one.function].notify for one in due if one.function in functions),
    }
    first = ChangeState.AWAITING_APPROVAL if asks else ChangeState.RUNNING

    def create(tx: Transaction) -> StoredRepair | None:
        if global_stop.hold(tx).active or drills.open_of(tx, state.id) is not None:
            return None
        stored = repairs.create(tx, state.id, state=first, data=data, fence=fence, change=True)
        _tell(tx, stored, LOOP, str(data["reason"]))
        return stored

    stored = await store.write(create, robots=(state.id,))
    return None if stored is None else ChangeRecord(store, stored, fence)


def _tell(tx: Transaction, stored: StoredRepair, by: str, reason: str) -> None:
    shown = change_json(stored)
    tx.emit(Kind.CONFIGURATION, stored.robot, shown)
    tx.note(
        AuditEntry(
            actor=by,
            action=f"change.{stored.state}",
            subject=stored.id,
            robot=stored.robot,
            reason=reason,
            after={"changes": shown["changes"]},
        )
    )


def _to_json(one: VariantChange) -> dict[str, Any]:
    return {
        "function": one.function,
        "from": one.source,
        "to": one.target,
        "reason": one.reason,
        "better": one.better,
        "fault": one.fault,
        "back_ns": None,
        "held": None,
    }


def changes_of(stored: StoredRepair) -> tuple[VariantChange, ...]:
    """Return the changes of a record."""
    return tuple(
        VariantChange(one["function"], one["from"], one["to"], one["reason"], one["better"], one["fault"])
        for one in stored.data["changes"]
    )


# --- the way back


def came_back(tx: Transaction, fence: Fence, function: Function, target: str, back_ns: int) -> None:
    """Note with the changes for the worse that a change to this variant undoes when that was."""
    for worse in _undone(tx, fence.robot, function, target):
        _amend(tx, fence, worse, function.name, back_ns=back_ns, held=None)


def is_held(tx: Transaction, fence: Fence, function: Function, target: str, why: str) -> None:
    """Note with the last change for the worse why it is not undone by a change to this variant."""
    held = held_back(target, why)
    worse = next(_undone(tx, fence.robot, function, target), None)
    if worse is not None and (change := _amend(tx, fence, worse, function.name, held=held)) is not None:
        tx.emit(Kind.CONFIGURATION, fence.robot, {**change_json(change), "held": held})


def _undone(view: View, robot: str, function: Function, target: str) -> Iterator[StoredRepair]:
    """Yield the changes for the worse that a change to this variant undoes, newest first; there is no way
    back to a variant that the model has no more.
    """
    order, paging = list(function.variants), Paging(limit=RECALLED)
    past = order[order.index(target) :]
    for stored in repairs.page(view, robot, paging, state=ChangeState.CHANGED, changes=True).items:
        for one in stored.data["changes"]:
            worse = not one["better"] and one["back_ns"] is None
            if worse and one["function"] == function.name and one["from"] in past:
                yield stored


def _amend(
    tx: Transaction, fence: Fence, worse: StoredRepair, function: str, **told: Any
) -> StoredRepair | None:
    """Write what became of a change's undoing; None: that is told already."""
    was = worse.data["changes"]
    changes = [{**one, **told} if one["function"] == function else one for one in was]
    if changes == was:
        return None
    new = {**worse.data, "changes": changes}
    return repairs.update(tx, worse.id, state=worse.state, data=new, open=False, fence=fence)
