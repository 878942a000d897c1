"""plant_fault and undo_fault: what a drill asks for, of the processes that the agent supervises.

plant_fault(camera_driver, node-frozen, 60)     at most 60 s, whatever becomes of the service
undo_fault(camera_driver, node-frozen)
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from robomend_client.actions import LEASES_S, Action, ActionResult, Feedback
from robomend_client.agent.executors.base import ActionExecutor
from robomend_client.agent.planted import KINDS, PlantedFaults


class PlantFault:
    """Plants a fault."""

    name = "plant_fault"
    gives_up = False  # half-way is on disk, and is undone

    def __init__(self, components: Sequence[str], planted: PlantedFaults) -> None:
        self.parameters = (tuple(components), KINDS, tuple(map(str, LEASES_S)))
        self._planted = planted

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        component, kind, lease_s = action.parameters
        feedback(1, f"{component}: {kind}")
        return await self._planted.plant(component, kind, float(lease_s))


class UndoFault:
    """Undoes it."""

    name = "undo_fault"
    gives_up = False

    def __init__(self, components: Sequence[str], planted: PlantedFaults) -> None:
        self.parameters = (tuple(components), KINDS)
        self._planted = planted

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        component, kind = action.parameters
        feedback(1, f"{component}: {kind} is being undone")
        return await self._planted.undo(component, kind, action.timeout_s)


def drilled(components: Sequence[str], planted: PlantedFaults) -> Iterable[ActionExecutor]:
    """Return the executors of an agent's drills; none if it has no processes."""
    return (PlantFault(components, planted), UndoFault(components, planted)) if components else ()
