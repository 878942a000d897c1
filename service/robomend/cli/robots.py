"""What `robomend doctor --robot` finds out of a robot: from a service that runs, or from the database."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Sequence
from typing import TYPE_CHECKING

from robomend.cli.remote.connection import asking
from robomend.errors import RobomendError

if TYPE_CHECKING:
    from robomend.robots.robot import Robot
    from robomend.settings import Settings


def asked(robot: str, url: str, key: str | None) -> Sequence[str]:
    """Return what the service at `url` says of the robot."""
    with asking(url, key, robot=robot) as client:
        found: Sequence[str] = client.robot(robot).value.get("findings", ())
        return found


def read(robot: str, settings: Settings) -> Sequence[str]:
    """Return what the database says of the robot (NotFound); which agents ask for work it cannot know."""
    return asyncio.run(_read(robot, settings))


async def _read(robot: str, settings: Settings) -> Sequence[str]:
    from robomend.repairs.agent_queue import AgentQueue
    from robomend.repairs.executors.registry import Surroundings
    from robomend.repairs.foresight import findings
    from robomend.robots import configuring
    from robomend.robots.boards import Boards
    from robomend.robots.memory import Memory
    from robomend.robots.readers import Readers
    from robomend.robots.systems import Systems
    from robomend.store import opened

    async def nothing(_: Robot | str) -> None: ...

    readers = Readers(settings)
    try:
        async with opened(settings.database_url) as store:
            memory = Memory(store, Systems(store, settings, readers), 1, taken_up=nothing, left=nothing)
            state = await memory.robot(robot)
            boards = Boards(
                store,
                lambda robot, said, time_ns: nothing(robot),
                lambda robot, said: None,
                lambda robot, link, why: None,
            )
            around = Surroundings(
                robot=robot,
                board=boards.made(robot, state.config, state.system.parts),
                agents=AgentQueue(store),
                hosts={},
                programs=settings.programs,
                webhook_hosts=settings.webhook_hosts,
                halt=asyncio.Event(),
            )
            faults = await configuring.faults(state.config, state.system, readers)
            actions: Sequence[str] = ()
            with contextlib.suppress(RobomendError):  # its domain is at fault: named already
                actions = await readers.actions(state.config.domain, state.system.parts)
            return findings(state, faults, actions, around, None)
    finally:
        await readers.close()
