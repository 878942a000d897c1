"""start_node and stop_node of the processes that the agent supervises."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from robomend_client.actions import Action, ActionResult, Feedback
from robomend_client.agent.executors.base import ActionExecutor
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
