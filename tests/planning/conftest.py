"""Both planners for the tests that ask each."""

from __future__ import annotations

import pytest
from tests.planning.robots import PLANNERS


@pytest.fixture(params=PLANNERS)
def planner(request: pytest.FixtureRequest) -> str:
    """The name of a planner."""
    return str(request.param)
