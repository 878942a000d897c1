"""One planner process for all loops of a session: starting one takes longer than most of these repairs."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest
from tests.postgres import postgres_server, postgres_url
from tests.repairs import robot

from robomend.planning.planner_pool import PlannerPool

__all__ = ["postgres_server", "postgres_url"]  # fixtures


@pytest.fixture(scope="session", autouse=True)
async def planners() -> AsyncIterator[PlannerPool]:
    """The session's planners; `tests.repairs.robot.service` uses them."""
    pool = PlannerPool(size=1, spare=1)
    robot.planners = pool
    yield pool
    robot.planners = None
    await pool.aclose()
