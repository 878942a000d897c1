"""What `robomend doctor --robot` finds out of a robot: from a service that runs, or from the database."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robomend.robots.robot import Robot
    from robomend.settings import Settings


def asked(robot: str, url: str, key: str | None) -> Sequence[str]:
    """Return what the service at `url` says of the robot (ClientError)."""
    from robomend_client.rest import Client

    with Client(url, key) as client:
        found: Sequence[str] = client.robot(robot).value.get("findings", ())
        return found


def read(robot: str, settings: Settings) -> Sequence[str]:
    """Return what the database says of the robot (NotFound); which agents ask for work it cannot know."""
    return asyncio.run(_read(robot, settings))


async def _read(robot: str, settings: Settings) -> Sequence[str]:
    from robomend.api.runtime import opened_store
    from robomend.repairs.agent_queue import AgentQueue
    from robomend.repairs.foresight import findings, surroundings
    from robomend.robots.boards import Boards
    from robomend.robots.memory import Memory
    from robomend.robots.systems import Systems

    async def nothing(_: Robot | str) -> None: ...

    async with opened_store(settings) as store:
        memory = Memory(store, Systems(store, settings), 1, taken_up=nothing, left=nothing)
        state = await memory.robot(robot)
        boards = Boards(store, lambda robot, said, time_ns: nothing(robot), lambda robot, link, why: None)
        board = boards.made(state.id, state.config, state.system.parts)
        return findings(state, surroundings(robot, board, AgentQueue(store), settings.programs), None)
