"""Many observation sets of one model: answered once, in memory that is bounded."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import pytest

from robomend.diagnosis.engines import make_engine
from robomend.diagnosis.ranking import posterior
from robomend.diagnosis.result import Diagnosis, DiagnosisResult, Engine, Options
from robomend.errors import ContradictoryModel
from robomend.model.loading import load_model, load_text
from robomend.oneshots import warm_model
from robomend.oneshots.result_json import quoted_names, result_text, timeless
from robomend.oneshots.warm_model import WarmModel, ask_engine
from robomend.resources import resource
from robomend_client.literals import Literal, fails

ROBOT = load_text(
    "robomend: 1\nhardware: {lidar: {channel: 1, prior: 0.1}}\nproperties: [lamp]\nnodes:\n"
    "  lidar_node: {drives: [lidar], publishes: {scan: []}, prior: 0.2}\n"
    "  mapper: {publishes: {map: [scan]}, prior: 0.1}\nrules: ['ok(lamp)']\n"
)

SEARCHED = load_text(
    "robomend: 1\nhardware: {a: {}, b: {}, c: {}}\nproperties: {p: {}, q: {}, r: {}}\nrules:\n"
    "- not ab(a) -> ok(p) or ok(q)\n- not ab(b) and ok(p) -> ok(r)\n- not ab(c) and ok(q) -> ok(r)\n"
)
"""Of which conflicts cannot be listed beforehand: an answer takes a search, which looks at the clock."""


def blamed(result: DiagnosisResult) -> list[tuple[str, ...]]:
    return [diagnosis.bad for diagnosis in result.diagnoses]


def test_equal_sets_have_the_same_answer_however_they_are_written() -> None:
    with WarmModel(ROBOT) as model:
        first = model.ask_line('["not ok(scan)", "ok(map)"]')
        assert model.ask_line('["not ok(scan)", "ok(map)"]') is first
        assert model.ask_line("ok(map), not ok(scan)") is first
        assert model.ask(model.question(["ok(map) and not ok(scan)"])) is first
        assert model.ask_line("not ok(scan)") is not first
    assert blamed(first.result) == [("lidar_node",), ("lidar",)]  # the likelier first
    assert not first.healthy


def test_only_so_many_answers_and_engines_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(warm_model, "REMEMBERED", 2)
    monkeypatch.setattr(warm_model, "ENGINES", 2)
    lines = ["not ok(scan)", "not ok(map)", "ok(scan)", "ok(scan) or ok(map)", "ok(map) or not ok(map)"]
    with WarmModel(ROBOT) as model:
        answers = [model.ask_line(line) for line in lines]
        assert model.ask_line(lines[-1]) is answers[-1]
        assert model.ask_line(lines[0]) is not answers[0]
        assert blamed(model.ask_line(lines[0]).result) == blamed(answers[0].result)


def test_an_answer_that_ran_out_of_time_is_not_kept() -> None:
    with WarmModel(SEARCHED, options=Options(timeout_s=0.0)) as model:
        first = model.ask_line("not ok(r)")
        assert first.result.stopped_by == "time"
        assert model.ask_line("not ok(r)") is not first


def test_an_answer_tells_its_own_time_but_no_more_than_the_diagnosis_took() -> None:
    with WarmModel(ROBOT) as model:
        explained = model.ask_line("not ok(scan)")
    took = explained.result.elapsed_s
    assert json.loads(explained.text(took / 2))["elapsed_s"] == pytest.approx(took / 2, abs=1e-6)
    assert json.loads(explained.text(1000.0))["elapsed_s"] == pytest.approx(took, abs=1e-6)


def test_a_set_that_contradicts_the_model_does_not_spoil_the_next() -> None:
    with WarmModel(ROBOT) as model:
        with pytest.raises(ContradictoryModel):
            model.ask_line("not ok(lamp)")
        assert model.ask_line("ok(lamp)").healthy


def test_a_set_has_one_answer_whatever_the_order_of_its_literals() -> None:
    """By itself an engine tells the conflict that it meets first, and here there are two."""
    cnf = load_model(resource("examples", "tedusar.yaml")).cnf
    seen = [fails("running", "imu_node"), fails("ok", "imu_data")]

    def texts(ask: Callable[[Engine, list[Literal]], DiagnosisResult]) -> set[str]:
        found = set()
        for order in (seen, seen[::-1]):
            engine = make_engine("sat", cnf)
            found.add(timeless(result_text(ask(engine, order), quoted_names(cnf.components))))
            engine.close()
        return found

    assert len(texts(lambda engine, order: engine.diagnose(order))) == 2
    assert len(texts(lambda engine, order: ask_engine(engine, cnf, order, Options()))) == 1


class NoScales:
    """An engine of a third party that does not weigh its diagnoses."""

    name = "no-scales"

    def diagnose(self, observations: object, options: object = None) -> DiagnosisResult:
        found = (Diagnosis(("lidar",)), Diagnosis(("lidar_node",)))
        return DiagnosisResult(ROBOT.cnf.components, found, True, None, (), 0.0)

    def consistent(self, observations: object) -> bool:
        return False

    def interrupt(self) -> None: ...

    def close(self) -> None: ...


def test_what_an_engine_does_not_weigh_is_weighed_by_the_priors_of_the_model() -> None:
    result = ask_engine(NoScales(), ROBOT.cnf, [], Options())
    assert blamed(result) == [("lidar_node",), ("lidar",)]
    shares = posterior([("lidar_node",), ("lidar",)], ROBOT.cnf.priors)
    assert shares is not None
    assert [diagnosis.probability for diagnosis in result.diagnoses] == list(shares)
    plain = ask_engine(NoScales(), replace(ROBOT.cnf, priors={}), [], Options())
    assert [diagnosis.probability for diagnosis in plain.diagnoses] == [None, None]
