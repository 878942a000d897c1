"""Each suite, tiny, over real processes; and contenders that are late, refuse or die."""

from __future__ import annotations

import multiprocessing
import os
import random
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from shutil import copyfile

import pytest

from robomend.diagnosis import sat
from robomend.diagnosis.circuits.netlist import Netlist, recover
from robomend.errors import InputError, OptionRefused
from robomend.model.cnf import HealthCnf
from robomend_bench.contenders import CHECKS, healthy_sets
from robomend_bench.exporting import Exported
from robomend_bench.generator import make_robot, observe
from robomend_bench.results import Run, Status
from robomend_bench.running import run_suite
from robomend_bench.suite import DATA, Answer, Ask, Group, Question, Wish, find_suite, suite_names
from robomend_bench.tables import markdown
from robomend_bench.worker import Contestant
from robomend_client.literals import holds

TINY = {
    "iscas85": ("c17",),
    "robots-v1": ("20",),
    "multi-observation": ("c17",),
    "sequential": ("made-60",),
    "feature-models": ("30",),
}


@pytest.fixture(autouse=True)
def no_process_is_left() -> Iterator[None]:
    yield
    assert not multiprocessing.active_children()


def tiny(name: str, mode: str, contenders: tuple[str, ...] = ()) -> Run:
    wish = Wish(mode=mode, only=TINY[name], instances=2, timeout_s=20.0)
    return run_suite(find_suite(name), wish, contenders, repeats=1)


@pytest.mark.parametrize(
    ("name", "mode"),
    [(name, mode) for name in TINY for mode in find_suite(name).modes if mode != "check"],
)
def test_every_suite_runs_in_every_mode_and_all_agree(name: str, mode: str) -> None:
    run = tiny(name, mode)
    assert run.disagreements == ()
    assert {sample.status for sample in run.samples} == {"ok"}
    assert len(run.samples) == 2 * len(run.contenders)
    assert all(built.peak_mib > 0 for built in run.built)


def test_the_check_is_timed_over_many_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robomend_bench.worker.START_METHOD", "spawn")  # as users run it: see conftest.py
    run = tiny("robots-v1", "check")
    assert [sample.status for sample in run.samples] == ["ok", "ok"]
    assert all(sample.result == (1,) for sample in run.samples)


def test_no_two_checks_of_a_measurement_are_about_the_same_set() -> None:
    robot = make_robot(20, 1)
    sets = [frozenset(one) for one in healthy_sets(observe(robot, 2, random.Random(1)))]
    assert len(set(sets)) == len(sets) == CHECKS
    assert len(list(healthy_sets([holds("on", "camera")]))) == CHECKS


def test_larger_diagnoses_that_were_not_wanted_are_no_time_out() -> None:
    wish = Wish(mode="subset", only=("c432",), instances=1, timeout_s=20.0, max_size=1, faults=(2, 2))
    run = run_suite(find_suite("iscas85"), wish, ("sat", "layered-full"), repeats=1)
    assert [sample.status for sample in run.samples] == ["ok", "ok"]
    assert run.disagreements == ()


def test_questions_of_one_minimum_cardinality_can_be_asked_for() -> None:
    wish = Wish(mode="first", only=("c432",), instances=3, faults=(3, 4), sizes=(2, 2))
    run = run_suite(find_suite("iscas85"), wish, ("sat",), repeats=1)
    assert {sample.result for sample in run.samples} == {(2,)}
    with pytest.raises(InputError, match="lower --size"):
        list(find_suite("iscas85").groups(Wish(mode="first", only=("c17",), faults=(1, 1), sizes=(4, 4))))


def test_equally_many_questions_of_each_minimum_cardinality_are_asked() -> None:
    wish = Wish(mode="first", only=("c432",), instances=4, sizes=(1, 2))
    (group,) = find_suite("iscas85").groups(wish)
    assert [question.name for question in group.questions] == ["01-0", "01-1", "02-0", "02-1"]
    run = run_suite(find_suite("iscas85"), wish, ("sat", "rc2-exhaust"), repeats=1)
    assert {(sample.question[:2], sample.result) for sample in run.samples} == {("01", (1,)), ("02", (2,))}


def test_questions_of_any_minimum_cardinality_come_as_they_are_drawn() -> None:
    wish = Wish(mode="first", only=("c432",), instances=4, faults=(1, 3), sizes="any")
    (group,) = find_suite("iscas85").groups(wish)
    assert [question.name for question in group.questions] == ["000-1f", "001-2f", "002-3f", "003-1f"]
    (all_of_them,) = find_suite("iscas85").groups(replace(wish, mode="all", sizes=None))
    assert group.questions == all_of_them.questions


def test_of_a_cardinality_that_a_circuit_does_not_allow_there_is_no_question() -> None:
    (group,) = find_suite("iscas85").groups(Wish(mode="first", only=("c17",)))
    assert {question.name[:2] for question in group.questions} == {"01", "02"}


def test_a_cold_start_reads_the_text_and_a_new_engine_only_the_model() -> None:
    for mode, kind in (("cold", str), ("once", HealthCnf)):
        wish = Wish(mode=mode, only=("c17",))
        suite = find_suite("iscas85")
        (group,) = suite.groups(wish)
        assert isinstance(group.model, kind)
        answers = [suite.prepare("sat", group, wish)(question) for question in group.questions]
        assert [answer.result for answer in answers] == [(int(q.name[:2]),) for q in group.questions]
        with pytest.raises(OptionRefused, match="ignores assumptions"):
            suite.prepare("sat:kissat404", group, wish)(group.questions[0])


def test_the_structure_is_found_for_those_who_measure_it(monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[HealthCnf] = []

    def counted(cnf: HealthCnf, check: Callable[[], None]) -> Netlist | None:
        found.append(cnf)
        return recover(cnf, check)

    monkeypatch.setattr(sat, "recover", counted)
    monkeypatch.setattr(sat, "AT_ONCE", 1e6)  # the first answer has seconds, on a busy computer, too
    suite = find_suite("iscas85")
    for mode, times in (("once", 0), ("structure", 1)):
        wish = Wish(mode=mode, only=("c17",), instances=1)
        (group,) = suite.groups(wish)
        found.clear()
        assert suite.prepare("sat", group, wish)(group.questions[0]).complete
        assert len(found) == times


def test_a_made_circuit_has_as_many_gates_as_it_says_and_questions_on_which_engines_agree() -> None:
    wish = Wish(mode="structure", only=("1000",), instances=2, faults=(1, 2), timeout_s=20.0)
    (group,) = find_suite("made-circuits").groups(wish)
    assert group.size == 1_000
    assert find_suite("made-circuits").contenders("structure") == ("sat",)
    run = run_suite(find_suite("made-circuits"), wish, ("sat", "rc2"), repeats=1)
    assert run.disagreements == ()
    assert {sample.status for sample in run.samples} == {"ok"}
    (other,) = find_suite("made-circuits").groups(replace(wish, seed=2))
    assert other.model.clauses != group.model.clauses
    with pytest.raises(InputError, match="choose from 1000"):
        list(find_suite("made-circuits").groups(replace(wish, only=("77",))))


def test_engines_take_part_with_the_solver_that_is_named() -> None:
    ours = ("sat", "sat:glucose4", "maxsat", "asp", "hs_dag", "cda_star")
    run = tiny("iscas85", "all", (*ours, "rc2", "layered-full", "clingo-domain"))
    assert run.disagreements == ()
    assert {sample.status for sample in run.samples} == {"ok"}


def test_who_does_not_know_a_mode_is_refused_and_the_others_go_on() -> None:
    run = tiny("iscas85", "subset", ("sat", "rc2", "sat:kissat404"))
    by_status = {sample.contender: sample.status for sample in run.samples}
    assert by_status == {"sat": "ok", "rc2": "refused", "sat:kissat404": "refused"}
    assert any("ignores assumptions" in sample.note for sample in run.samples)


def test_suites_are_found_by_name() -> None:
    assert set(TINY) <= set(suite_names())
    with pytest.raises(OptionRefused, match="no suite is named 'nothing'"):
        find_suite("nothing")
    for name in TINY:
        with pytest.raises(InputError):
            list(find_suite(name).groups(Wish(mode=next(iter(find_suite(name).modes)), only=("no such",))))


def test_questions_are_the_same_for_the_same_seed() -> None:
    for name in TINY:
        suite = find_suite(name)
        wish = Wish(mode=next(iter(suite.modes)), only=TINY[name], instances=3)
        assert list(suite.groups(wish)) == list(suite.groups(wish))


def test_circuits_that_do_not_come_with_the_package_are_read_from_a_folder(tmp_path: Path) -> None:
    suite = find_suite("itc99")
    with pytest.raises(InputError, match="where they can be had"):
        list(suite.groups(Wish(mode="first")))
    (tmp_path / "itc99").mkdir()
    copyfile(DATA / "iscas85" / "c17.bench", tmp_path / "itc99" / "b14.bench")
    wish = Wish(mode="first", only=("b14",), data=tmp_path)
    (group,) = suite.groups(wish)
    assert {question.name[:2] for question in group.questions} == {"01", "02"}
    assert suite.prepare("sat", group, wish)(group.questions[0]).result == (1,)


C17 = """// MC = 2

observation obs_c17_1
{
    i1 && !i2 && i3 && i4 &&
    !i5 && !o1 && o2;
}
[c17,two,[-i1,-i2,-i3,-i4,-i5,o1,-o2]].
"""


def test_observation_sets_of_others_are_read_and_asked(tmp_path: Path) -> None:
    suite = find_suite("observations")
    with pytest.raises(InputError, match="where they can be had"):
        list(suite.groups(Wish(mode="few")))
    (tmp_path / "observations").mkdir()
    file = tmp_path / "observations" / "c17.obs"
    file.write_text(C17)
    (group,) = suite.groups(Wish(mode="few", data=tmp_path))
    assert [question.name for question in group.questions] == ["02-obs_c17_1", "02-two"]
    seen = {str(literal) for literal in group.questions[0].payload}
    assert seen == {"v(1)", "not v(2)", "v(3)", "v(6)", "not v(7)", "not v(22)", "v(23)"}
    run = run_suite(suite, Wish(mode="few", data=tmp_path), ("sat", "rc2", "rc2-exhaust"), repeats=1)
    assert run.disagreements == ()
    assert {sample.status for sample in run.samples} == {"ok"}
    for text, said in (("nothing", "no observation"), (C17.replace("o2", "o3"), "line 3: 'o3'.*o1 to o2")):
        file.write_text(text)
        with pytest.raises(InputError, match=said):
            list(suite.groups(Wish(mode="few", data=tmp_path)))


def test_an_output_that_is_an_input_says_nothing_of_gates(tmp_path: Path) -> None:
    for folder in ("iscas85", "observations"):
        (tmp_path / folder).mkdir()
    (tmp_path / "iscas85" / "c17.bench").write_text("INPUT(a)\nOUTPUT(a)\nOUTPUT(b)\nb = NOT(a)\n")
    (tmp_path / "observations" / "c17.obs").write_text("[c17,1,[i1,-o1,o2]].")
    suite, wish = find_suite("observations"), Wish(mode="first", data=tmp_path)
    (group,) = suite.groups(wish)
    assert suite.prepare("sat", group, wish)(group.questions[0]).result == (1,)


class Odd:
    """A suite whose contenders misbehave; found in the child by the name of this module."""

    name = "odd"
    version = "1"
    summary = "contenders that misbehave"
    modes: Mapping[str, str] = {"first": "nothing"}

    def contenders(self, mode: str) -> tuple[str, ...]:
        return ("late",)

    def groups(self, wish: Wish) -> Iterator[Group]:
        yield Group("odd", 1, None, (Question("q", None), Question("other", None)))

    def prepare(self, contender: str, group: Group, wish: Wish) -> Ask:
        def late(question: Question) -> Answer:
            time.sleep(600)  # longer than anybody waits
            return Answer((1,), complete=True)

        def dead(question: Question) -> Answer:
            os._exit(1)

        def wrong(question: Question) -> Answer:
            raise ValueError("it has a bug")

        calls: list[str] = []

        def counting(question: Question) -> Answer:
            calls.append(question.name)
            return Answer((len(calls), calls[-2:].count("q")), complete=True)

        return {"late": late, "dead": dead, "wrong": wrong, "counting": counting}[contender]

    def exported(self, question: Question, group: Group) -> Exported:
        raise OptionRefused("nobody else is asked")


@pytest.mark.parametrize(
    ("contender", "timeout_s", "status", "note"),
    [
        ("late", 0.05, "timeout", "killed"),
        ("dead", 300.0, "error", "died"),
        ("wrong", 300.0, "error", "it has a bug"),
    ],
)
def test_a_contender_that_misbehaves_harms_nobody(
    contender: str, timeout_s: float, status: str, note: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # fork, so that the child knows the suite of this test
    monkeypatch.setattr("robomend_bench.worker.START_METHOD", "fork")
    monkeypatch.setattr("robomend_bench.worker.find_suite", lambda name: Odd())
    (group,) = Odd().groups(Wish(mode="first"))
    contestant = Contestant("odd", contender, group, Wish(mode="first", timeout_s=timeout_s))
    try:
        for _ in range(2):  # it starts again after the first
            got, _answer, _seconds, why = contestant.ask(0)
            assert got == status
            assert note in why
    finally:
        contestant.close()


def test_who_runs_out_of_time_is_asked_the_same_question_twice_only(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    class Slow:
        """A contender that never has the first answer, and always the second."""

        name, build_s, base_mib, peak_mib = "slow", 0.0, 0.0, 0.0

        def __init__(self, *arguments: object) -> None:
            pass

        def ask(self, index: int) -> tuple[Status, None, float, str]:
            asked.append(index)
            return ("timeout" if index == 0 else "ok"), None, 1.0, ""

        def close(self) -> None:
            pass

    monkeypatch.setattr("robomend_bench.running.Contestant", Slow)
    run = run_suite(Odd(), Wish(mode="first"), ("slow",), repeats=3)
    assert asked == [0, 1, 0, 1, 1, 1]  # warmed up by the first two
    assert [sample.status for sample in run.samples] == ["timeout", "ok", "ok", "ok"]
    table = markdown(run_suite(Odd(), Wish(mode="first"), ("slow", "other", "third"), repeats=1))
    assert "| slow | 1/2 |" in table
    monkeypatch.setattr(Slow, "ask", lambda self, index: ("timeout", None, 1.0, ""))
    table = markdown(run_suite(Odd(), Wish(mode="first"), ("slow", "other", "third"), repeats=1))
    assert "| slow | 0/2 |" in table
    assert "fastest other" not in table  # nobody is


@pytest.mark.parametrize(("run_up_s", "calls"), [(60.0, (3, 1)), (0.0, (2, 1))])
def test_a_quick_first_question_is_answered_again_before_the_others(
    run_up_s: float, calls: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robomend_bench.worker.START_METHOD", "fork")
    monkeypatch.setattr("robomend_bench.worker.find_suite", lambda name: Odd())
    monkeypatch.setattr("robomend_bench.worker.RUN_UP_S", run_up_s)
    (group,) = Odd().groups(Wish(mode="first"))
    contestant = Contestant("odd", "counting", group, Wish(mode="first"))
    try:
        contestant.ask(0)
        _status, answer, _seconds, _note = contestant.ask(1)
        assert answer is not None
        assert answer.result == calls
    finally:
        contestant.close()
