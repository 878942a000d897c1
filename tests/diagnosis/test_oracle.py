"""The persistent SAT solver, and what comes between."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robomend.diagnosis.oracle import INTERRUPTIBLE, Deadline, Oracle, solver_name
from robomend.diagnosis.shrinking import Witnesses, shrunk

PIGEONS = """
from itertools import combinations
from robomend.diagnosis.oracle import Deadline, Oracle

n = 12  # holes for n + 1 pigeons: no solver of this kind is soon done with it
number = lambda pigeon, hole: pigeon * n + hole + 1
clauses = [[number(pigeon, hole) for hole in range(n)] for pigeon in range(n + 1)]
clauses += [
    [-number(one, hole), -number(other, hole)]
    for hole in range(n)
    for one, other in combinations(range(n + 1), 2)
]
oracle = Oracle(clauses, Deadline())
print("at work", flush=True)
try:
    print(oracle.quickly([], -1, -1))
except KeyboardInterrupt:
    print("interrupted")
"""


def test_ctrl_c_in_the_middle_of_a_short_question_is_a_keyboard_interrupt() -> None:
    """The solver's library takes the signal while it computes, and raises an error of its own."""
    with subprocess.Popen([sys.executable, "-c", PIGEONS], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "at work\n"
        while process.poll() is None:
            try:
                process.wait(0.5)  # it is in the solver by then
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGINT)
        assert process.stdout.read() == "interrupted\n"
        assert process.returncode == 0


@pytest.mark.parametrize("solver", INTERRUPTIBLE)
def test_clauses_added_together_count_and_a_closed_solver_takes_none(solver: str) -> None:
    oracle = Oracle([[1, 2]], Deadline(), solver_name(solver))
    oracle.add_all([(-1,), [-2, 3]])
    assert oracle.sat([])
    assert not oracle.sat([-3])
    oracle.close()
    for _ in range(1_000):  # memory that was freed would be written to
        oracle.add([4, 5])
        oracle.add_all([(4, 5), (-4, 6)])


# --- contradictions made minimal within a bound on the questions


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
