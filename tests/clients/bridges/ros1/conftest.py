"""A real robot for each test that asks for one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.ros1 import Robot, robot


@pytest.fixture
def ros(tmp_path: Path) -> Iterator[Robot]:
    with robot(tmp_path) as found:
        yield found
