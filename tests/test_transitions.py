"""State machines as tables: what has no row is refused. What is drawn of them: test_drawn_docs.py."""

from __future__ import annotations

from enum import StrEnum

import pytest

from robomend.errors import RobomendError
from robomend.transitions import NoTransition, after


class Door(StrEnum):
    OPEN = "open"
    SHUT = "shut"
    BRICKED_UP = "bricked-up"


class Hand(StrEnum):
    PUSHES = "somebody pushes"
    PULLS = "somebody pulls"
    BRICKS = "a wall is built"


DOOR = {
    (Door.OPEN, Hand.PUSHES): Door.SHUT,
    (Door.SHUT, Hand.PULLS): Door.OPEN,
    (Door.OPEN, Hand.BRICKS): Door.BRICKED_UP,
    (Door.SHUT, Hand.BRICKS): Door.BRICKED_UP,
}


def test_a_row_gives_the_state_after() -> None:
    assert after(DOOR, Door.OPEN, Hand.PUSHES) is Door.SHUT


def test_what_has_no_row_is_refused_by_name_as_a_bug_of_ours() -> None:
    with pytest.raises(NoTransition) as refused:
        after(DOOR, Door.BRICKED_UP, Hand.PULLS)
    assert str(refused.value) == "Door bricked-up: PULLS (somebody pulls) cannot happen here"
    assert not isinstance(refused.value, RobomendError)  # nobody takes it for the world's doing
