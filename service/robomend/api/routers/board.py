"""/robots/{robot}/board: the power board's channels."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path

from robomend.api.deps import PartsDep, PrincipalDep, RobotPath
from robomend.api.gate import GuardedRoute
from robomend.api.problems import problems
from robomend.api.schemas.repair import BoardOut, ChannelBody
from robomend.api.views import board_out
from robomend.security import API

router = APIRouter(prefix=f"{API}/robots/{{robot}}/board", tags=["board"], route_class=GuardedRoute)

ChannelPath = Annotated[int, Path(ge=0, le=255, description="the channel's number")]


@router.get("", responses=problems(404))
async def get_board(robot: RobotPath, parts: PartsDep) -> BoardOut:
    """Return the link's state and each channel's reading; null is unknown."""
    return board_out(await parts.robots.board(robot))


@router.put("/channels/{channel}", status_code=204, responses=problems(404, 409, 502, 504, body=True))
async def switch_channel(
    robot: RobotPath, channel: ChannelPath, body: ChannelBody, parts: PartsDep, principal: PrincipalDep
) -> None:
    """Switch a channel; returns when the board has acknowledged.

    Refused for switching off what is protected, during the global stop, and while OBS does not show the
    model's `act_when`.
    """
    switch = parts.repairs.switch
    board = await parts.robots.board(robot)
    state = await parts.robots.memory.robot(robot)
    await board.switch(
        channel,
        body.on,
        stop=lambda: switch.stop,
        interlocked=state.interlocked,
        by=principal.name,
        reason=body.reason,
    )
