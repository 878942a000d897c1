"""The robot that the tests of drills share."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from tests.drills.drilled_robot import DrilledRobot, drilled_robot
from tests.waiting import until

HELD: list[DrilledRobot] = []
"""The robot, while tests of this folder are run: it takes seconds to start, and all its life a processor."""

STACK = ExitStack()
"""Ends it."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Generator[None]:
    """Let go of the robot before a test of another folder."""
    try:
        yield
    finally:
        if nextitem is None or Path(__file__).parent not in nextitem.path.parents:
            HELD.clear()
            STACK.close()


@pytest.fixture
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DrilledRobot]:
    """The robot, healthy; whatever a test plants on it must be undone."""
    if not HELD:
        HELD.append(STACK.enter_context(drilled_robot(tmp_path_factory.mktemp("drilled"))))
    [shared] = HELD
    shared.until_healthy()
    yield shared
    with shared.client as client:
        client.resume()
    until(lambda: not shared.leftovers(), "everything is undone", 60.0)
