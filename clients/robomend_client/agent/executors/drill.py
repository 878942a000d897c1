"""plant_fault and undo_fault: what a drill asks for, of the agent's processes and of the topics of its bus.

plant_fault(camera_driver, node-frozen, 60)     at most 60 s, whatever becomes of the service
plant_fault(image, topic-dropped, 60)
undo_fault(camera_driver, node-frozen)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from robomend_client.actions import LEASES_S, Action, ActionResult, Feedback
from robomend_client.agent.executors.base import ActionExecutor
from robomend_client.agent.planted import KINDS, PlantedFaults
from robomend_client.agent.topic_faults import TOPIC_KINDS


class PlantFault:
    """Plants a fault in a process, or in a topic."""

    name = "plant_fault"
    gives_up = False  # half-way is on disk, and is undone

    def __init__(self, names: Sequence[str], kinds: Sequence[str], planted: PlantedFaults) -> None:
        self.parameters = (tuple(names), tuple(kinds), tuple(map(str, LEASES_S)))
        self._planted = planted

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        name, kind, lease_s = action.parameters
        feedback(1, f"{name}: {kind}")
        return await self._planted.plant(name, kind, float(lease_s))


class UndoFault:
    """Undoes it."""

    name = "undo_fault"
    gives_up = False

    def __init__(self, names: Sequence[str], kinds: Sequence[str], planted: PlantedFaults) -> None:
        self.parameters = (tuple(names), tuple(kinds))
        self._planted = planted

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        name, kind = action.parameters
        feedback(1, f"{name}: {kind} is being undone")
        return await self._planted.undo(name, kind, action.timeout_s)


def drilled(components: Sequence[str], planted: PlantedFaults) -> Iterator[ActionExecutor]:
    """Yield the executors of an agent's drills; none if it has neither processes nor topics."""
    for names, kinds in ((components, KINDS), (planted.topics, TOPIC_KINDS)):
        if names:
            yield PlantFault(names, kinds, planted)
            yield UndoFault(names, kinds, planted)
