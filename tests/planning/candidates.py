"""Diagnoses with plans of a known cost, and repairs that were tried, for the tests of choosing."""

from __future__ import annotations

from robomend.diagnosis.result import Diagnosis
from robomend.planning.choice import Candidate
from robomend.planning.plan import Outcome, Plan, Step
from robomend.planning.tried import Attempt
from robomend_client.literals import fails, holds

SECOND = 1_000_000_000


def plan(cost: float, *repairs: str, unreachable: tuple[str, ...] = ()) -> Plan:
    steps = tuple(
        Step(i, "mend", (name,), cost / len(repairs), (), (), (holds("good", name), fails("bad", name)))
        for i, name in enumerate(repairs)
    )
    outcome = Outcome.UNSOLVABLE if unreachable else Outcome.SOLVED
    return Plan(outcome, steps, cost if steps else 0.0, "test", frozenset(), (), unreachable, (), 0.0)


def candidate(
    bad: str, cost: float, probability: float | None = None, repairs: str | None = None
) -> Candidate:
    names = tuple(bad.split())
    made = plan(cost, *(repairs.split() if repairs is not None else names))
    return Candidate(Diagnosis(names, probability), made)


def tried(bad: str, *, seen: bool = True, helped: bool = False, at_s: int = 0, repaired: str = "") -> Attempt:
    return Attempt(frozenset(bad.split()), frozenset((repaired or bad).split()), at_s * SECOND, seen, helped)
