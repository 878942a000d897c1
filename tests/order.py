"""In which order workers take the tests: what takes long first, so that none is alone with it at the end.

xdist (`--dist worksteal`) gives each worker a piece of the list as it stands, and takes from the end of one
piece what another worker has time for. So what takes long is dealt to the pieces, and stands in front; what
is quick fills them up. What shares something that takes seconds to start (a browser, a robot) stays together.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from importlib import import_module
from itertools import groupby, islice
from pathlib import Path

import pytest

ROOT = Path(__file__).parent

LONG = (
    "web",
    "robomend_batch/test_attach.py",
    "test_blocks.py",
    "drills",
    "store",
    "service",
    "robomend_bench/test_service.py",
    "clients/bridges/ros2",
    "clients/bridges/ros1",
    "test_tutorial.py",
    "robomend_demo/test_demo.py",
    "batches",
    "clients/bridges/test_evidence.py",
    "clients/bridges/test_looking_away.py",
    "robomend_bench/faults",
    "api/test_generated_client.py",
    "test_packaging.py",
    "repairs/test_two_instances.py",
    "repairs/test_crash.py",
    "repairs/test_repairs.py",
    "repairs/test_doubt.py",
    "robomend_batch/learn",
    "clients/bridges",
    "repairs",
    "robomend_demo",
    "robomend_bench",
    "api/test_roles.py",
    "api/test_process.py",
    "test_site.py",
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


def load(asked: Sequence[str], number: int, workers: int) -> None:
    """Import the modules of the tests that are asked for, each worker beginning with another one.

    In a fresh checkout every module is compiled, and its assertions are written anew, before it can be
    imported, which takes twice as long as all imports. Workers that import in the same order do that at the
    same time; so each one finds compiled what another has begun with. What cannot be imported is left to
    pytest, which says so.
    """
    files: set[Path] = set()
    for path in (Path(argument.partition("::")[0]).resolve() for argument in asked):
        files |= {path} if path.is_file() else set(path.rglob("test_*.py"))
    modules = [
        ".".join(file.relative_to(ROOT.parent).with_suffix("").parts)
        for file in sorted(files)
        if file.is_relative_to(ROOT)
    ]
    begin = len(modules) * number // workers
    for module in (*modules[begin:], *modules[:begin]):
        with contextlib.suppress(Exception, pytest.skip.Exception):
            import_module(module)
