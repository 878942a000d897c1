"""Actions that an agent on the robot pulls, carries out and reports, through the queue (agent_queue.py).

While it acts, an agent sends feedback twice a second or more; 409 tells it that the action is withdrawn.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Mapping
from typing import Any

from robomend.errors import RobomendError, StoreError
from robomend.poller import wait_for
from robomend.repairs.agent_queue import LOOK_AGAIN_S, AgentQueue
from robomend.repairs.executors.registry import Surroundings
from robomend.store.records import AgentAction, Fence
from robomend_client.actions import (
    CANCELLED,
    TIMED_OUT,
    UNREACHABLE,
    Action,
    ActionResult,
    Executor,
    Feedback,
)


def make(action: str, options: Mapping[str, Any], around: Surroundings) -> Executor:
    """Return the robot's agents, on whichever host a component is (robomend.repairs.executors.registry)."""
    return AgentExecutor(around.agents, around.robot, around.hosts, around.halt, around.fence)


class AgentExecutor:
    """Carries out one robot's actions through its agents."""

    def __init__(
        self,
        queue: AgentQueue,
        robot: str,
        hosts: Mapping[str, str | None],
        halt: asyncio.Event | None = None,
        fence: Fence | None = None,
    ) -> None:
        """
        Args:
            hosts: component -> the host whose agent acts on it; None or absent: any agent of the robot.
            halt: set when an action is cut off because nobody wants it any more; else it may go on, and
                whoever takes over asks for its result.
            fence: of the robot's owner: nothing is queued by anybody else.
        """
        self._fence = fence
        self._queue = queue
        self._robot = robot
        self._hosts = dict(hosts)
        self._halt = halt

    async def execute(self, action: Action, feedback: Feedback) -> ActionResult:
        host = next((self._hosts[p] for p in action.parameters if self._hosts.get(p)), None)
        loop = asyncio.get_running_loop()
        deadline = loop.time() + action.timeout_s
        change = self._queue.watch(self._robot)
        state = await self._queue.put(self._robot, host, action, self._fence)
        told: tuple[int, str] | None = None
        try:
            while state.code is None and (left := deadline - loop.time()) > 0:
                await wait_for(change, min(left, LOOK_AGAIN_S))
                change = self._queue.watch(self._robot)
                with contextlib.suppress(StoreError):  # it may come back within our time
                    state = await self._queue.action(action.id)
                said = self._queue.said.get(action.id, told)
                if said is not None and said != told:
                    told = said
                    feedback(*said)
        except asyncio.CancelledError:
            with contextlib.suppress(RobomendError):  # then the agent's own time-out ends it
                await asyncio.shield(self._cut_off(action))
            raise
        if state.code is not None:
            return ActionResult(state.code, state.message)
        state = await self._take_back(action)
        if state.code is not None and state.answered:
            return ActionResult(state.code, state.message)  # it came in just now
        who = f"the agent on {host}" if host else "the robot's agent"
        if state.taken_by is None:
            return ActionResult(UNREACHABLE, f"{who} did not take it within {action.timeout_s:g} s")
        return ActionResult(TIMED_OUT, f"{who} took it and did not report in {action.timeout_s:g} s")

    async def _cut_off(self, action: Action) -> None:
        state = await self._take_back(action)
        if state.code is None and self._halt is not None and self._halt.is_set():
            await self._queue.finish(action.id, CANCELLED, "withdrawn while the agent was at it")

    async def _take_back(self, action: Action) -> AgentAction:
        return await self._queue.withdraw(action.id, "withdrawn: nobody asked for it in time")
