"""The garbage collector looks at little at a time, often, and never at what was loaded at the start."""

from __future__ import annotations

import gc
import subprocess
import sys
from collections.abc import Iterator

import pytest

from robomend import garbage


@pytest.fixture
def _by_hand() -> Iterator[None]:
    """Nobody else looks meanwhile."""
    gc.disable()
    yield
    gc.enable()


def looked() -> list[int]:
    return [generation["collections"] for generation in gc.get_stats()]


@pytest.mark.usefixtures("_by_hand")
def test_what_is_young_is_looked_at_often_what_survived_now_and_then_and_what_is_old_not_at_all() -> None:
    looks, before = garbage.Looks(), looked()
    for _ in range(2 * garbage.SURVIVORS_EVERY):
        looks.at_sign()
    each_two_s = garbage.SURVIVORS_EVERY // garbage.YOUNG_EVERY
    assert [now - then for now, then in zip(looked(), before, strict=True)] == [2 * (each_two_s - 1), 2, 0]


class Circle:
    """Holds itself."""

    def __init__(self, freed: list[int]) -> None:
        self.itself = self
        self.freed = freed

    def __del__(self) -> None:
        self.freed.append(1)


@pytest.mark.usefixtures("_by_hand")
def test_a_circle_is_freed_within_a_few_signs_and_one_that_survived_a_look_within_two_seconds() -> None:
    looks, freed = garbage.Looks(), list[int]()
    circle = Circle(freed)
    for _ in range(garbage.YOUNG_EVERY):
        looks.at_sign()  # it is held, and survives
    del circle
    Circle(freed)
    for _ in range(garbage.YOUNG_EVERY):
        looks.at_sign()
    assert freed == [1]
    for _ in range(garbage.SURVIVORS_EVERY):
        looks.at_sign()
    assert freed == [1, 1]


def test_what_is_loaded_at_the_start_is_never_looked_at_again() -> None:
    program = (
        "import gc; gc.disable()\n"
        "from robomend import garbage\n"
        "loaded = len(gc.get_objects())\n"
        "garbage.settle()\n"
        "print(gc.isenabled(), gc.get_freeze_count() > loaded / 2, len(gc.get_objects()) < loaded / 20)\n"
        "print(gc.get_threshold() == garbage.THRESHOLDS)"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert ran.stdout.split() == ["True"] * 4, ran.stderr
