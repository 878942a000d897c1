"""Contradictions made minimal within a bound on the questions, and what models tell without a question."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from robomend.diagnosis.oracle import Deadline, Oracle
from robomend.diagnosis.shrinking import Witnesses, shrunk

CHAIN = 200
"""Inverters in a row: gate i is variable i, its input CHAIN + i, its output CHAIN + i + 1."""


class Asked:
    """Refutes whatever holds all of a core, and counts."""

    def __init__(self, *core: int) -> None:
        self.core = set(core)
        self.questions = 0

    def __call__(self, literals: list[int]) -> list[int] | None:
        self.questions += 1
        return literals if self.core.issubset(literals) else None


@given(st.sets(st.integers(1, 60), min_size=1), st.integers(1, 60))
def test_what_is_left_is_the_core_whatever_is_around_it(core: set[int], last: int) -> None:
    asked = Asked(*core)
    assert shrunk(range(1, max(last, *core) + 1), asked, 1_000) == (sorted(core), True)


def test_witnesses_name_only_what_is_needed() -> None:
    # 3 must follow from each of 1 and 2: neither is needed
    clauses = [[-1, 3], [-2, 3]]
    oracle = Oracle(clauses, Deadline())
    needed: set[int] = set()
    assert oracle.sat([-3])
    Witnesses(clauses, 2, {3}, lambda: None).needed(oracle.model(), {1, 2}, needed)
    assert needed == set()
    oracle.close()
