"""start_node and stop_node of the processes that the agent supervises; and what a drill asks for, of them and
of the topics of the agent's bus.

    plant_fault(camera_driver, node-frozen, 60)     at most 60 s, whatever becomes of the service
    plant_fault(image, topic-dropped, 60)
    undo_fault(camera_driver, node-frozen)
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from robomend_client.actions import LEASES_S, Action, ActionResult, Feedback
from robomend_client.agent.executors.base import ActionExecutor
from robomend_client.agent.planted import KINDS, TOPIC_KINDS, PlantedFaults
from robomend_client.agent.processes import SupervisedProcess

SLACK_S = 2.0
"""For what is beside a process' own time: its turn, the guard, the way to the service."""


class StartNode:
    """Starts a process and waits for the evidence that it runs."""

    name = "start_node"
    gives_up = True

    def __init__(self, processes: Mapping[str, SupervisedProcess]) -> None:
        self.parameters = (tuple(processes),)
        self.takes_s = {name: one.spec.start_timeout_s + SLACK_S for name, one in processes.items()}
        self._processes = processes

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        return await self._processes[action.parameters[0]].start(feedback, action.timeout_s)


class StopNode:
    """Stops a process."""

    name = "stop_node"
    gives_up = False

    def __init__(self, processes: Mapping[str, SupervisedProcess]) -> None:
        self.parameters = (tuple(processes),)
        self.takes_s = {name: one.spec.stop_grace_s + SLACK_S for name, one in processes.items()}
        self._processes = processes

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        return await self._processes[action.parameters[0]].stop(feedback, action.timeout_s)


def supervised(processes: Mapping[str, SupervisedProcess]) -> Iterable[ActionExecutor]:
    """Return the executors of an agent's processes; none if it has none."""
    return (StartNode(processes), StopNode(processes)) if processes else ()


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
