"""What the repairs of all robots share, and what executors are made with."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

from robomend.repairs.agent_queue import AgentQueue
from robomend.repairs.choosing import Chooser
from robomend.repairs.execution_values import nobodys
from robomend.repairs.executors.registry import Surroundings
from robomend.repairs.stop_switch import StopSwitch
from robomend.robots.boards import WiredBoard
from robomend.robots.robots import Robots
from robomend.settings import Settings
from robomend.store import Store
from robomend.store.records import Fence


@dataclass
class Dependencies:
    """See the module."""

    store: Store
    robots: Robots
    agents: AgentQueue
    chooser: Chooser
    switch: StopSwitch
    settings: Settings

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
