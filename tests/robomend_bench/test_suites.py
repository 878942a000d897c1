"""Each suite, tiny, over real processes; and contenders that are late, refuse or die."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from shutil import copyfile

import pytest

from robomend.errors import InputError, OptionRefused
from robomend_bench.exporting import Exported
from robomend_bench.results import Run
from robomend_bench.running import run_suite
from robomend_bench.suite import DATA, Answer, Ask, Group, Question, Wish, find_suite, suite_names
from robomend_bench.worker import Contestant

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
    wish = Wish(mode=mode, only=TINY[name], instances=2, timeout_s=300.0)
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


def test_questions_of_one_minimum_cardinality_can_be_asked_for() -> None:
    wish = Wish(mode="first", only=("c432",), instances=3, faults=(3, 4), sizes=(2, 2))
    run = run_suite(find_suite("iscas85"), wish, ("sat",), repeats=1)
    assert {sample.result for sample in run.samples} == {(2,)}
    with pytest.raises(InputError, match="lower --size"):
        list(find_suite("iscas85").groups(Wish(mode="first", only=("c17",), faults=(1, 1), sizes=(4, 4))))


def test_a_made_circuit_has_as_many_gates_as_it_says_and_questions_on_which_engines_agree() -> None:
    wish = Wish(mode="structure", only=("1000",), instances=2, faults=(1, 2), timeout_s=300.0)
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


def test_every_contender_plans_the_papers_scenarios() -> None:
    suite = find_suite("plans")
    wish = Wish(mode="time", only=("tedusar",), timeout_s=300)
    (group,) = suite.groups(wish)
    for contender in suite.contenders("time"):
        ask = suite.prepare(contender, group, wish)
        assert [ask(question).shown for question in group.questions] == [12, 3], contender
    with pytest.raises(OptionRefused, match="no contender"):
        suite.prepare("graphplan", group, wish)


def test_mode_cost_compares_the_cost_of_plans_on_both_groups() -> None:
    wish = Wish(mode="cost", instances=2, timeout_s=300)
    run = run_suite(find_suite("plans"), wish, ("asp", "pyperplan"), repeats=1)
    assert {(sample.group, sample.bound) for sample in run.samples} == {
        (group, bound) for group in ("small-robots", "supplied-robots") for bound in (1.0, 1.1)
    }
    assert all(sample.cost for sample in run.samples)
    assert run.disagreements == ()
