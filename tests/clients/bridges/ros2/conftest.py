"""A real robot for each test that asks for one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.ros2 import Ros2Robot, robot


@pytest.fixture
def ros(tmp_path: Path) -> Iterator[Ros2Robot]:
    with robot(tmp_path) as found:
        yield found
