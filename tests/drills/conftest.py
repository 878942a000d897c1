"""The robot that the tests of drills share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.drills.drilled_robot import DrilledRobot, drilled_robot
from tests.waiting import until


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DrilledRobot]:
    """One robot for all tests: it takes seconds to start."""
    with drilled_robot(tmp_path_factory.mktemp("drilled")) as robot:
        yield robot


@pytest.fixture
def robot(shared: DrilledRobot) -> Iterator[DrilledRobot]:
    """The robot, healthy; whatever a test plants on it must be undone."""
    shared.until_healthy()
    yield shared
    with shared.client as client:
        client.resume()
    until(lambda: not shared.leftovers(), "everything is undone", 60.0)
