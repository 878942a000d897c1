"""Robots for the tests that ask for one: of a kind, or of each kind."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.clients.bridges.any_robot import ORIGINS, AnyRobot, any_robot
from tests.ros1 import Robot
from tests.ros1 import robot as ros1_robot
from tests.ros2 import Ros2Robot
from tests.ros2 import robot as ros2_robot
from tests.zenoh_robot import ZenohRobot
from tests.zenoh_robot import robot as new_zenoh_robot


@pytest.fixture
def ros1(tmp_path: Path) -> Iterator[Robot]:
    with ros1_robot(tmp_path) as found:
        yield found


@pytest.fixture
def ros2(tmp_path: Path) -> Iterator[Ros2Robot]:
    with ros2_robot(tmp_path) as found:
        yield found


@pytest.fixture
def zenoh_robot(tmp_path: Path) -> Iterator[ZenohRobot]:
    with new_zenoh_robot(tmp_path) as found:
        yield found


@pytest.fixture(params=ORIGINS)
def robot(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[AnyRobot]:
    with any_robot(request.param, tmp_path) as found:
        yield found
