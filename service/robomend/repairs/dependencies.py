"""What the repairs of all robots share, and who carries out what for one of them."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

from robomend.errors import Refused
from robomend.repairs.agent_queue import AgentQueue
from robomend.repairs.choosing import Chooser, hosts_of
from robomend.repairs.execution_values import nobodys
from robomend.repairs.executors.registry import Surroundings, executors
from robomend.repairs.stop_switch import StopSwitch
from robomend.robots.boards import WiredBoard
from robomend.robots.robot import Robot
from robomend.robots.robots import Robots
from robomend.settings import Settings
from robomend.store import Store
from robomend.store.records import Fence
from robomend_client.actions import Executor


@dataclass
class Dependencies:
    """See the module."""

    store: Store
    robots: Robots
    agents: AgentQueue
    chooser: Chooser
    switch: StopSwitch
    settings: Settings

    async def executors(self, state: Robot, halt: asyncio.Event, fence: Fence) -> dict[str, Executor]:
        """Return who carries out what for a robot, as it is configured now.

        Raises:
            Refused: its model says nothing of what can be repaired.
        """
        parts = state.system.parts
        if parts is None:
            raise Refused(f"a {state.system.format} model says nothing of what can be repaired")
        board = None if state.config.board is None else await self.robots.board(state.id)
        around = self.around(state.id, board, hosts_of(parts), halt, fence)
        actions = dict.fromkeys((*await self.chooser.actions(state), *parts.acts))
        return executors(actions, state.config.actions, around)

    def around(
        self,
        robot: str,
        board: WiredBoard | None,
        hosts: Mapping[str, str | None],
        halt: asyncio.Event,
        fence: Fence | None = None,
    ) -> Surroundings:
        """Return what the executors of a robot's actions are made with; without a fence nothing is sent."""
        confirm = nobodys if fence is None else partial(self.store.ownership.confirm, fence)
        return Surroundings(
            robot=robot,
            board=board,
            agents=self.agents,
            hosts=hosts,
            programs=self.settings.programs,
            webhook_hosts=self.settings.webhook_hosts,
            halt=halt,
            confirm=confirm,
            fence=fence,
        )
