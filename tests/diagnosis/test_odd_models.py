"""Models that break searches, with default options: an answer, in so many questions to the solver and no
more.

Bounds are on steps, never on seconds; `robomend-bench odd` measures the time.
"""

from __future__ import annotations

from typing import Any

import pytest

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.hitting import HittingSets
from robomend.diagnosis.oracle import Oracle
from robomend.diagnosis.result import DiagnosisResult, Options
from robomend_bench.odd_models import MODELS, Question


class Steps:
    """How often a solver was asked, and how many nodes were searched."""

    def __init__(self) -> None:
        self.asked = 0
        self.nodes = 0


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> Steps:
    counted = Steps()
    sat, start, spend = Oracle.sat, Oracle.__init__, HittingSets._spend

    def counting_sat(self: Oracle, assumptions: list[int]) -> bool:
        counted.asked += 1
        return sat(self, assumptions)

    def counting_start(self: Oracle, *arguments: Any, **more: Any) -> None:
        start(self, *arguments, **more)
        propagate = self.propagate

        def counting_propagate(literals: list[int]) -> Any:
            counted.asked += 1
            return propagate(literals)

        self.propagate = counting_propagate

    def counting_spend(self: HittingSets, nodes: int) -> None:
        counted.nodes += nodes
        spend(self, nodes)

    monkeypatch.setattr(Oracle, "sat", counting_sat)
    monkeypatch.setattr(Oracle, "__init__", counting_start)
    monkeypatch.setattr(HittingSets, "_spend", counting_spend)
    return counted


def asked(name: str, size: int) -> tuple[Question, DiagnosisResult]:
    question = MODELS[name][0](size)
    engine = make_engine("sat", question[0])
    result = engine.diagnose(question[1], Options(timeout_s=None))  # only the bounds on steps can end it
    engine.close()
    return question, result


# model, size -> size of the smallest diagnoses, exact number, questions to a solver, nodes
KNOWN = {
    ("chain", 2_000): (1, 2_000, 0, 0),
    ("ring", 1_000): (1, 100, 0, 0),
    ("closed-ring", 1_000): (0, 1, 0, 0),
    ("fan-out", 500): (1, 1_001, 0, 10),
    ("fan-in", 2_000): (1, 2_001, 0, 0),
    ("grid", 40): (1, 1_600, 0, 0),
    ("silent", 1_000): (333, 2**333, 0, 0),
    ("independent", 200): (200, 2**200, 0, 0),
    ("one-supply", 300): (1, 2**300 + 1, 0, 10),
    ("many-publishers", 300): (300, 1, 0, 0),
    ("all-alarms", 600): (600, 1, 0, 0),
    ("no-news", 2_000): (0, 1, 0, 0),
    ("wide-rule", 2_000): (1, 2_000, 0, 0),
    ("ladder", 6): (2, 6, 0, 1_000),
    ("all-pairs", 30): (29, 30, 0, 600),
    ("steiner", 2): (5, 54, 0, 1_000),
    ("either-or-apart", 100): (100, 2**100, 1_500, 400),
    ("modes", 60): (40, 1, 500, 200),
}


@pytest.mark.parametrize(("name", "size"), KNOWN)
def test_an_odd_model_is_answered_with_an_exact_count_in_few_steps(
    name: str, size: int, steps: Steps
) -> None:
    least, count, questions, nodes = KNOWN[name, size]
    _, result = asked(name, size)
    assert len(result.diagnoses[0].bad) == least
    assert result.count == count
    assert result.complete or result.stopped_by == "limit"
    assert len(result.diagnoses) == min(100, count)
    assert result.complete or result.factored
    assert steps.asked <= questions
    assert steps.nodes <= nodes


@pytest.mark.parametrize(
    ("name", "size", "questions", "nodes"),
    [
        ("ladder", 40, 10_000, 3_000),
        ("overlapping", 60, 1_000, 21_000),
        ("either-or", 300, 2_000, 10),
        ("parity-chain", 300, 2_000, 10),
    ],
)
def test_where_there_are_too_many_the_smallest_are_told_in_bounded_steps(
    name: str, size: int, questions: int, nodes: int, steps: Steps
) -> None:
    (cnf, seen), result = asked(name, size)
    assert result.diagnoses
    assert steps.asked <= questions
    assert steps.nodes <= nodes
    sizes = [len(diagnosis.bad) for diagnosis in result.diagnoses]
    assert sizes == sorted(sizes)
    engine = make_engine("sat", cnf)
    options = Options(minimal="cardinality", limit=1, timeout_s=None, conflicts=False)
    assert len(engine.diagnose(seen, options).diagnoses[0].bad) == sizes[0]
    engine.close()
