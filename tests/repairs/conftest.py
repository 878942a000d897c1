"""One planner process for all loops of a session: starting one takes longer than most of these repairs."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest
from tests.postgres import postgres_server, postgres_url
from tests.repairs import robot

from robomend.planning.planner_pool import PlannerPool
from robomend.transitions import NoTransition

__all__ = ["postgres_server", "postgres_url"]  # fixtures


@pytest.fixture(scope="session")
async def planners() -> AsyncIterator[PlannerPool]:
    """The session's planners; `tests.repairs.robot.service` uses them."""
    pool = PlannerPool(size=1, spare=1)
    robot.planners = pool
    yield pool
    robot.planners = None
    await pool.aclose()


@pytest.fixture(autouse=True)
def _planners_for_services(request: pytest.FixtureRequest) -> None:
    """Only for tests that run on the session's event loop: the executors' have loops of their own."""
    here = request.path.parent == Path(__file__).parent
    if here and "anyio_backend" in request.fixturenames:
        request.getfixturevalue("planners")


@pytest.fixture(autouse=True)
def _only_listed_transitions(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> Iterator[None]:
    """Whoever catches a NoTransition, the test of a running service in which it happened fails."""
    refused: list[str] = []
    made = NoTransition.__init__

    def note(self: NoTransition, *args: object) -> None:
        made(self, *args)  # type: ignore[arg-type]  # whatever it is called with
        refused.append(str(self))

    monkeypatch.setattr(NoTransition, "__init__", note)
    yield
    if request.node.get_closest_marker("anyio") is not None:
        assert refused == []
