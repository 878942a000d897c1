"""encodings/diagnosis.lp by its own contract, without the engine around it."""

from __future__ import annotations

import clingo

from robomend.resources import resource

TWO_LAMPS = """
component(1..3). variable(1..5).
clause(1). negative(1,1). negative(1,2). positive(1,4).
clause(2). negative(2,1). negative(2,3). positive(2,5).
"""
"""A battery (1) feeds two lamps (2, 3); a lamp is lit (4, 5) if both are healthy."""


def diagnoses(
    arguments: list[str], parts: list[str], observed: dict[int, bool], bound: int | None = None
) -> list[list[int]]:
    control = clingo.Control([*arguments, "0"])
    control.load(str(resource("encodings", "diagnosis.lp")))
    control.add("base", [], TWO_LAMPS)
    control.ground([("base", []), *((part, []) for part in parts)])
    assumptions = [(clingo.Function("true", [clingo.Number(v)]), sign) for v, sign in observed.items()]
    if bound is not None:
        control.ground([("bound", [clingo.Number(bound)])])
        control.assign_external(clingo.Function("at_most", [clingo.Number(bound)]), True)
    found = []
    with control.solve(assumptions=assumptions, yield_=True) as handle:
        for answer in handle:
            if not parts or answer.optimality_proven:
                found.append(sorted(symbol.arguments[0].number for symbol in answer.symbols(shown=True)))
    return sorted(found)


SUBSET = ["--heuristic=Domain", "--dom-mod=5,16", "--enum-mode=domRec", "--project=show"]
MINIMUM = ["--opt-mode=optN", "--project=show"]


def test_both_lamps_dark_is_the_battery_or_both_lamps() -> None:
    assert diagnoses(SUBSET, [], {4: False, 5: False}) == [[1], [2, 3]]


def test_minimum_keeps_the_common_cause() -> None:
    assert diagnoses(MINIMUM, ["minimum"], {4: False, 5: False}) == [[1]]


def test_what_is_supposed_is_an_assumption_too() -> None:
    assert diagnoses(SUBSET, [], {4: False, 5: False, 1: True}) == [[2, 3]]
