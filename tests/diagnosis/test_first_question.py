"""Questions for one diagnosis of a circuit are answered without its structure until it pays."""

from __future__ import annotations

import random
from dataclasses import replace
from typing import Any

import pytest

from robomend.diagnosis import reasons, sat
from robomend.diagnosis.oracle import Deadline, Oracle, OutOfTime
from robomend.diagnosis.result import Options
from robomend.diagnosis.sat import SatEngine
from robomend.model.loading import load_text
from robomend_bench.circuit_faults import observe_faulty, read_circuit
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


def test_the_structure_is_found_when_questions_without_it_took_a_multiple_of_its_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sat, "AT_ONCE", 1e6)  # however long a question takes here
    clock = [0.0]
    monkeypatch.setattr(sat, "thread_time", lambda: clock[0])
    engine = SatEngine(CNF)
    go_on = engine._by_solver.go_on
    structure_s = sat.STRUCTURE_S + len(CNF.components) * sat.STRUCTURE_GATE_S

    def slow(*asked: Any) -> None:
        clock[0] += structure_s
        go_on(*asked)

    monkeypatch.setattr(engine._by_solver, "go_on", slow)
    sizes = []
    while not with_structure(engine):
        sizes.append(least(engine, 0))
    assert sat.PAYS_AFTER * structure_s < clock[0] <= (sat.PAYS_AFTER + 1) * structure_s
    assert len(set(sizes)) == 1
    assert 0.3 * clock[0] > structure_s  # so that all of it took at most 1.3 times what it took without


def test_the_structure_can_be_had_beforehand() -> None:
    prepared, other = SatEngine(CNF), SatEngine(CNF)
    prepared.prepare(SEEN[0])
    assert with_structure(prepared)
    assert [least(prepared, number) for number in range(6)] == [least(other, number) for number in range(6)]
    robot = load_text("robomend: 1\nname: r\nnodes: {a: {publishes: {x: []}}}\n").cnf
    engine = SatEngine(robot)
    engine.prepare([fails("ok", "x")])
    assert [one.bad for one in engine.diagnose([fails("ok", "x")]).diagnoses] == [("a",)]


def test_all_diagnoses_are_searched_by_structure_at_once() -> None:
    for options in (Options(), Options(minimal="cardinality"), Options(minimal="cardinality", factored=True)):
        engine = SatEngine(CNF)
        engine.diagnose(SEEN[0], options)
        assert with_structure(engine)


def test_the_structure_is_not_looked_for_where_that_would_take_most_of_the_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wanted = [Options(max_size=3), Options(minimal="cardinality"), Options(minimal="cardinality", limit=1)]
    for options in wanted:
        patient = SatEngine(CNF).diagnose(SEEN[0], replace(options, timeout_s=None))
        with monkeypatch.context() as patch:
            patch.setattr(sat, "HURRIED_GATE_S", 20.0)  # 160 gates
            engine = SatEngine(CNF)
            for _ in range(2):
                hurried = engine.diagnose(SEEN[0], replace(options, timeout_s=1_000.0))
                assert hurried.complete == patient.complete
                if options.limit != 1:
                    assert {d.bad for d in hurried.diagnoses} == {d.bad for d in patient.diagnoses}
            assert not with_structure(engine)
        assert engine.diagnose(SEEN[0], replace(options, timeout_s=None)).complete == patient.complete
        assert with_structure(engine) == (options.limit != 1)  # for one diagnosis it does not pay yet


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


def test_the_time_out_of_the_first_question_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sat, "AT_ONCE", 1e6)
    result = SatEngine(CNF).diagnose(SEEN[0], Options(minimal="cardinality", limit=1, timeout_s=0.0))
    assert (result.diagnoses, result.stopped_by) == ((), "time")


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


def test_a_question_to_the_solver_ends_with_its_part_of_the_work() -> None:
    holes = 9
    place = {(p, h): 1 + p * holes + h for p in range(holes + 1) for h in range(holes)}
    clauses = [[place[p, h] for h in range(holes)] for p in range(holes + 1)]
    clauses += [
        [-place[p, h], -place[q, h]] for h in range(holes) for p in range(holes + 1) for q in range(p)
    ]
    clock = Deadline()
    clock.start(None)
    pigeons = Oracle(clauses, clock)
    with pytest.raises(OutOfTime), clock.at_most(0.01):
        pigeons.sat([])
    pigeons.close()


def test_time_is_kept_for_what_comes_after_besides_what_was_kept_before() -> None:
    clock = Deadline()
    clock.reserve_more(1e6)  # no deadline: there is always enough
    clock.start(1_000.0)
    clock.reserve(400.0)
    clock.reserve_more(300.0)
    assert 200.0 < clock.left_s <= 300.0
    with pytest.raises(OutOfTime):
        clock.reserve_more(300.0)


def test_conflicts_for_which_no_time_is_left_are_said_to_be_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reasons, "WATCHED_S", 1e6)
    engine = SatEngine(CNF)
    hurried = engine.diagnose(SEEN[0], Options(minimal="cardinality", timeout_s=1_000.0))
    assert hurried.complete
    assert not hurried.conflicts_complete
    patient = engine.diagnose(SEEN[0], Options(minimal="cardinality", timeout_s=None))
    assert patient.conflicts
    assert {d.bad for d in patient.diagnoses} == {d.bad for d in hurried.diagnoses}
