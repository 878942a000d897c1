"""How a repair that ends is told."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

from robomend.repairs.conclusions import ALL_WELL, well
from robomend_client.literals import Atom, Literal

GOAL = Literal(Atom("ok", ("goal",)), False)


def ended(*, revision: int, diagnosed: int, healthy: bool = True) -> str:
    """Return the reason of a repair of a robot whose goal, from outside, is silent."""
    current = SimpleNamespace(revision=diagnosed, healthy=healthy)
    state = SimpleNamespace(literals=lambda: (GOAL,), revision=revision, current=current)
    return well(ALL_WELL, cast(Any, state))


def test_what_is_silent_although_nobody_is_blamed_is_told() -> None:
    assert ended(revision=7, diagnosed=7) == (
        "no component is blamed any more; not ok(goal): still seen, and the model blames nobody for it"
    )


def test_of_what_came_after_the_diagnosis_it_is_not_said_that_nobody_is_blamed_for_it() -> None:
    """A topic that flaps falls silent while its repair ends: the next one is about it."""
    assert ended(revision=8, diagnosed=7) == ALL_WELL
    assert ended(revision=8, diagnosed=8, healthy=False) == ALL_WELL
