"""In which order workers take the tests: what takes long first, so that none is alone with it at the end.

xdist (`--dist worksteal`) gives each worker a piece of the list as it stands, and takes from the end of one
piece what another worker has time for. So what takes long is dealt to the pieces, and stands in front; what
is quick fills them up. What shares something that takes seconds to start (a browser, a robot) stays together.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby, islice
from pathlib import Path

import pytest

ROOT = Path(__file__).parent

LONG = (
    "test_tutorial.py",
    "web",
    "drills",
    "robomend_bench/test_service.py",
    "store",
    "robomend_demo/test_demo.py",
    "clients/bridges/ros1",
    "clients/bridges/ros2",
    "repairs/test_two_instances.py",
    "test_blocks.py",
    "repairs/test_repairs.py",
    "repairs/test_crash.py",
    "repairs/test_doubt.py",
    "robomend_bench/faults",
    "service",
    "batches",
    "test_packaging.py",
    "repairs",
    "robomend_demo",
    "robomend_bench",
    "clients/bridges",
    "api/test_process.py",
    "api/test_generated_client.py",
    "test_mutate.py",
)
"""Rooms and files of more than about ten seconds, the longest first. The first that fits counts."""


def rank(path: Path) -> int:
    """Return where a file stands among those that take long; behind them if it does not."""
    inside = path.relative_to(ROOT)
    for place, name in enumerate(LONG):
        if inside.is_relative_to(name):
            return place
    return len(LONG)


def dealt(items: Sequence[pytest.Item], workers: int) -> list[pytest.Item]:
    """Return the tests in as many pieces of the same length as there are workers, the long ones in front."""
    ranks = {path: rank(path) for path in {item.path for item in items}}
    quick = [item for item in items if ranks[item.path] == len(LONG)]
    slow = sorted((item for item in items if ranks[item.path] < len(LONG)), key=lambda item: ranks[item.path])
    pieces: list[list[pytest.Item]] = [[] for _ in range(workers)]
    for number, (_, together) in enumerate(groupby(slow, lambda item: ranks[item.path])):
        turn, place = divmod(number, workers)
        pieces[place if turn % 2 == 0 else workers - 1 - place] += together
    left = iter(quick)
    for number, piece in enumerate(pieces):
        end = len(items) * (number + 1) // workers
        room = end - len(items) * number // workers - len(piece)
        piece += islice(left, max(0, room))
    return [*(item for piece in pieces for item in piece), *left]
