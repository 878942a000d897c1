"""A search that is stopped tells what it has: bounds of the smallest size, a diagnosis, what is proved."""

from __future__ import annotations

from typing import Any

import pytest
from tests.diagnosis.netlists import circuit

from robomend.diagnosis import sat
from robomend.diagnosis.core_guided import CoreGuided
from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.oracle import OutOfTime
from robomend.diagnosis.result import DiagnosisResult, Options
from robomend.oneshots.result_json import result_json

MADE = circuit("c880")
FIRST = Options("cardinality", limit=1, timeout_s=None, conflicts=False)


def stopped_after(
    questions: int, seed: int, options: Options, monkeypatch: pytest.MonkeyPatch, *, structure: bool
) -> DiagnosisResult:
    """Ask with no time for more than so many questions of the core-guided search."""
    engine = make_engine("sat", MADE.cnf)
    seen = MADE.observe(12, seed)
    if structure:
        engine.prepare(seen)  # type: ignore[attr-defined]  # of this engine
    left = [questions]

    def counted(ask: Any) -> Any:
        def asked(*arguments: Any) -> Any:
            left[0] -= 1
            if left[0] < 0:
                engine._clock.stop()  # type: ignore[attr-defined]  # as `interrupt`
                raise OutOfTime
            return ask(*arguments)

        return asked

    fresh = CoreGuided._fresh_or_warm

    def bounded(guided: CoreGuided) -> Any:
        oracle = fresh(guided)
        oracle.sat, oracle.quickly = counted(oracle.sat), counted(oracle.quickly)  # type: ignore[method-assign]  # of this one
        return oracle

    with monkeypatch.context() as patch:
        patch.setattr(CoreGuided, "_fresh_or_warm", bounded)
        patch.setattr(sat, "AT_ONCE", 1e6)
        result = engine.diagnose(seen, options)
    engine.close()
    return result


@pytest.mark.parametrize("structure", [False, True])
def test_bounds_hold_and_meet_in_the_end(structure: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    best = unproved = 0
    for seed in range(3):
        engine = make_engine("sat", MADE.cnf)
        seen = MADE.observe(12, seed)
        size = len(engine.diagnose(seen, FIRST).diagnoses[0].bad)
        at_least = 0
        for questions in range(0, 3 * size + 9, 2):
            result = stopped_after(questions, seed, FIRST, monkeypatch, structure=structure)
            assert result.size_at_least is not None
            assert at_least <= result.size_at_least <= size
            at_least = result.size_at_least
            if result.size_at_most is not None:
                assert size <= result.size_at_most
            assert result.smallest_proved == (result.size_at_least == result.size_at_most)
            unproved += not result.smallest_proved
            for diagnosis in result.diagnoses:
                best += 1
                bad = frozenset(diagnosis.bad)
                assert len(bad) == result.size_at_most
                healthy = frozenset(MADE.cnf.components) - bad
                assert engine.diagnose(seen, Options(healthy=healthy, limit=1, conflicts=False)).diagnoses
        assert at_least == size
        engine.close()
    assert unproved
    assert best > 10


def test_what_is_complete_is_proved_and_where_size_ended_the_search_the_next_one_bounds_it() -> None:
    engine = make_engine("sat", MADE.cnf)
    seen = MADE.observe(12, 0)
    size = len(engine.diagnose(seen, FIRST).diagnoses[0].bad)
    for options in (Options("cardinality", conflicts=False), FIRST):
        told = engine.diagnose(seen, options)
        assert (told.smallest_proved, told.size_at_least, told.size_at_most) == (True, size, size)
    smaller = engine.diagnose(seen, Options("cardinality", max_size=size - 1, conflicts=False))
    assert (smaller.stopped_by, smaller.smallest_proved) == ("size", False)
    assert (smaller.size_at_least, smaller.size_at_most) == (size, None)
    assert result_json(smaller)["size_at_least"] == size
    engine.close()
