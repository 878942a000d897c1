"""A robot's key opens the robot's own actions only; the path of an action does not name its robot."""

from __future__ import annotations

from robomend.errors import NotFound
from robomend.repairs.repairs import Repairs
from robomend.security import Principal, Role


async def check_own_action(repairs: Repairs, principal: Principal, action: str) -> None:
    """Let a robot's key through to its own actions; the others do not exist for it."""
    if principal.role is Role.ROBOT and await repairs.action_robot(action) != principal.robot:
        raise NotFound(f"there is no action {action!r}")
