"""A robot for each test that asks for one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.zenoh_robot import ZenohRobot, robot


@pytest.fixture
def zenoh_robot(tmp_path: Path) -> Iterator[ZenohRobot]:
    with robot(tmp_path) as found:
        yield found
