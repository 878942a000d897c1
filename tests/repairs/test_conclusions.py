"""How a repair that ends is told."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

from robomend.repairs.conclusions import ALL_WELL, Silent, end_of, well
from robomend.repairs.execution_values import Ending
from robomend.repairs.states import RepairTrigger
from robomend_client.literals import Atom, Literal

GOAL = Literal(Atom("ok", ("goal",)), False)


def test_what_is_silent_although_nobody_is_blamed_is_told() -> None:
    state = SimpleNamespace(literals=lambda: (GOAL,))  # its goal, from outside, is silent
    assert well(ALL_WELL, cast(Any, state)) == (
        "no component is blamed any more; not ok(goal): still seen, and the model blames nobody for it"
    )


def vain(reason: str, ending: Ending = Ending.EFFECT_MISSING) -> dict[str, Any]:
    return {"ending": str(ending), "helped": False, "reason": reason, "plan": []}


def silent(*rounds: dict[str, Any], why: str = "nobody reported ok(scan)") -> str:
    trigger, reason = end_of(Silent(why), cast(Any, SimpleNamespace(reason="")), {"rounds": rounds})
    assert trigger is RepairTrigger.NEEDS_PERSON
    return reason


def test_who_is_silent_is_told_after_what_was_tried_and_not_twice() -> None:
    assert silent() == "nobody reported ok(scan)"
    assert silent(vain("a failed")) == "a failed; nobody reported ok(scan)"
    stale = vain("b was not seen, and nobody spoke", Ending.STALE)
    assert silent(vain("a failed"), stale, why=stale["reason"]) == (
        "tried, the last first: b was not seen, and nobody spoke; a failed"
    )
