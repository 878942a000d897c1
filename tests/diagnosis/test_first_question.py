"""Questions for one diagnosis of a circuit are answered without its structure until it pays."""

from __future__ import annotations

import random
from dataclasses import replace
from typing import Any

import pytest

from robomend.diagnosis import conflicts, sat
from robomend.diagnosis.oracle import Deadline, OutOfTime
from robomend.diagnosis.result import Options
from robomend.diagnosis.sat import SatEngine
from robomend.model.loading import load_text
from robomend_bench.generator import observe_faulty, read_circuit
from robomend_bench.suite import DATA
from robomend_client.literals import fails, holds

TEXT = (DATA / "iscas85" / "c432.bench").read_text()
CNF = load_text(TEXT, name="c432", format="bench").cnf
FIRST = Options(minimal="cardinality", limit=1, timeout_s=None)
SEEN = [observe_faulty(read_circuit(TEXT), 4, random.Random(seed)) for seed in range(6)]


def least(engine: SatEngine, number: int) -> int:
    result = engine.diagnose(SEEN[number], FIRST)
    assert result.conflicts
    return len(result.diagnoses[0].bad)


def with_structure(engine: SatEngine) -> bool:
    return "_by_structure" in vars(engine)


def test_a_first_question_that_takes_longer_goes_on_with_the_structure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sat, "AT_ONCE", -1.0)
    late = [SatEngine(CNF) for _ in SEEN]
    sizes = [least(engine, number) for number, engine in enumerate(late)]
    assert all(map(with_structure, late))
    monkeypatch.setattr(sat, "AT_ONCE", 1e6)
    for number, size in enumerate(sizes):
        at_once = SatEngine(CNF)
        assert least(at_once, number) == size
        assert not with_structure(at_once)
        assert least(late[number], number) == size  # the passes are there now


HELD = {"healthy": frozenset(CNF.components[:40]), "abnormal": frozenset(CNF.components[40:42])}


@pytest.mark.parametrize("hold", [HELD, {"max_size": 1}, {"max_size": 9}])
def test_the_whole_circuit_is_asked_as_its_structure_is(
    hold: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    for seen in SEEN:
        asked = replace(FIRST, **hold)
        monkeypatch.setattr(sat, "AT_ONCE", 1e6)
        first = SatEngine(CNF).diagnose(seen, asked)
        monkeypatch.setattr(sat, "AT_ONCE", -1.0)
        second = SatEngine(CNF).diagnose(seen, asked)
        assert [len(d.bad) for d in first.diagnoses] == [len(d.bad) for d in second.diagnoses]
        assert (first.complete, first.stopped_by) == (second.complete, second.stopped_by)
        assert not any(set(d.bad) & set(asked.healthy) for d in first.diagnoses)
        assert all(set(d.bad) >= set(asked.abnormal) for d in first.diagnoses)


def test_a_time_out_while_the_structure_is_looked_for_is_kept_and_spoils_nothing() -> None:
    text = "INPUT(n0)\nOUTPUT(n600)\n" + "".join(f"n{i} = NOT(n{i - 1})\n" for i in range(1, 601))
    cnf = load_text(text, format="bench").cnf
    engine = SatEngine(cnf)
    seen = [holds("v", "n0"), fails("v", "n600")]
    hurried = engine.diagnose(seen, Options(timeout_s=0.0))
    assert (hurried.diagnoses, hurried.stopped_by) == ((), "time")
    assert not with_structure(engine)
    assert engine.diagnose(seen, Options(timeout_s=None, limit=None)).count == 600


def test_a_part_of_the_work_ends_by_the_thread_s_own_time_or_the_deadline() -> None:
    clock = Deadline()
    clock.start(1000.0)
    with clock.at_most(1000.0):
        clock.check()
    with pytest.raises(OutOfTime), clock.at_most(0.0):
        clock.check()
    clock.check()
    clock.start(0.0)
    with pytest.raises(OutOfTime), clock.at_most(1000.0):
        clock.check()


def test_conflicts_for_which_no_time_is_left_are_said_to_be_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conflicts, "WATCHED_S", 1e6)
    engine = SatEngine(CNF)
    hurried = engine.diagnose(SEEN[0], Options(minimal="cardinality", timeout_s=1_000.0))
    assert hurried.complete
    assert not hurried.conflicts_complete
    patient = engine.diagnose(SEEN[0], Options(minimal="cardinality", timeout_s=None))
    assert patient.conflicts
    assert {d.bad for d in patient.diagnoses} == {d.bad for d in hurried.diagnoses}
