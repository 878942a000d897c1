"""Contradictions made minimal within a bound on the questions, and what models tell without a question."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from robomend.diagnosis.oracle import Deadline, Oracle
from robomend.diagnosis.shrinking import minimised, shrunk
from robomend.diagnosis.witnesses import Extract, Witnesses

MANY = list(range(1, 1_001))
CHAIN = 200
"""Inverters in a row: gate i is variable i, its input CHAIN + i, its output CHAIN + i + 1."""

INVERTERS = [
    clause
    for i in range(1, CHAIN + 1)
    for a, b in [(CHAIN + i, CHAIN + i + 1)]
    for clause in ((-i, a, b), (-i, -a, -b))
]


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


def test_few_literals_of_many_are_found_in_few_questions() -> None:
    asked = Asked(3, 500, 999)
    assert shrunk(MANY, asked, 1_000) == ([3, 500, 999], True)
    assert asked.questions < 70  # one by one it were a thousand


def test_a_bound_on_the_questions_is_kept_and_what_was_gained_is_told() -> None:
    asked = Asked(*range(1, 1_001, 7))
    literals, minimal = shrunk(MANY, asked, 50)
    assert asked.questions == 50
    assert not minimal
    assert asked.core <= set(literals)


def test_literals_known_to_be_needed_are_not_tried() -> None:
    asked = Asked(*MANY)
    assert shrunk(MANY, asked, 10, needed=set(MANY)) == (MANY, True)
    assert asked.questions == 0


def test_a_chain_of_gates_is_seen_to_be_minimal_in_a_handful_of_questions() -> None:
    with Extract(
        [tuple(clause) for clause in INVERTERS], range(1, CHAIN + 1), Deadline(), "minisat22"
    ) as extract:
        asked = 0
        sat = extract.oracle.sat

        def counted(assumptions: list[int]) -> bool:
            nonlocal asked
            asked += 1
            return sat(assumptions)

        extract.oracle.sat = counted  # type: ignore[method-assign]  # counts, and hands on
        seen = extract.known([CHAIN + 1, -(2 * CHAIN + 1)])  # an even number of inverters: both should agree
        fixed = frozenset(map(abs, seen))
        witnesses = Witnesses(extract.clauses, CHAIN, fixed, lambda: None)
        gates = list(range(1, CHAIN + 1))
        components, observations, minimal = minimised(extract.oracle, gates, seen, seen, set(), witnesses)
    assert sorted(components) == gates
    assert sorted(observations) == sorted(seen)
    assert minimal
    assert asked < 30


def test_witnesses_name_only_what_is_needed() -> None:
    # 3 must follow from each of 1 and 2: neither is needed
    clauses = [[-1, 3], [-2, 3]]
    oracle = Oracle(clauses, Deadline())
    needed: set[int] = set()
    assert oracle.sat([-3])
    Witnesses(clauses, 2, {3}, lambda: None).needed(oracle.model(), {1, 2}, needed)
    assert needed == set()
    oracle.close()
