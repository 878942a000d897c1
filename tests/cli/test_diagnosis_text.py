"""A diagnosis in words: a screen of lines, the rest counted."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from robomend.cli.diagnosis_text import WIDTH, leading_first, told
from robomend.diagnosis.result import Conflict, Diagnosis, DiagnosisResult, Options
from robomend.model.loading import load_model, load_text
from robomend.oneshots.warm_model import WarmModel
from robomend.resources import resource
from robomend_client.literals import fails

MANIPULATOR = load_model(resource("examples", "mobile_manipulator.yaml"))
TEDUSAR = load_model(resource("examples", "tedusar.yaml"))


def lines(*sentences: str, system: object = MANIPULATOR, everything: bool = False) -> list[str]:
    """Return what the command shows for a question."""
    assert system in (MANIPULATOR, TEDUSAR)
    with WarmModel(MANIPULATOR if system is MANIPULATOR else TEDUSAR) as model:
        asked = model.question(sentences)
        result = leading_first(model.ask(asked).result)
        probes = model.probes(asked, result, limit=3, timeout_s=5.0)
    return told(result, probes, everything=everything, repairable=True)


def result(*blamed: str, conflicts: int = 0, **more: object) -> DiagnosisResult:
    """Return diagnoses, each of components separated by spaces."""
    diagnoses = tuple(Diagnosis(tuple(names.split())) for names in blamed)
    components = tuple(sorted({name for diagnosis in diagnoses for name in diagnosis.bad}))
    found = tuple(
        Conflict((f"c{number}",), (fails("ok", "x"),), (), f"conflict {number}")
        for number in range(conflicts)
    )
    known: dict[str, object] = {"complete": True, "stopped_by": None, "elapsed_s": 0.001, **more}
    return DiagnosisResult(components, diagnoses, conflicts=found, **known)  # type: ignore[arg-type]  # fields by name


def test_many_alike_are_counted_and_the_next_step_is_said() -> None:
    shown = lines("not ok(cmd_vel)")
    assert shown[0] == "18 diagnoses, any one of which explains what was seen:"
    assert shown[2:8] == [
        "   13.2%  head_camera_driver",
        "    9.8%  head_camera",
        "    9.8%  localization",
        "    6.5%  usb_hub",
        "    6.5%  front_lidar",
        "  … and 13 more, 54.4% together",
    ]
    assert shown[shown.index("look next at") + 1].startswith("  ok(head_depth)  16 of 18 diagnoses left if")
    assert len(shown) < 25


@pytest.mark.parametrize(
    ("sentences", "first"),
    [
        (["ok(scan)"], "healthy: this is what a system without fault would show"),
        (["not on(jaguar)"], "1 diagnosis explains what was seen:"),
        (["not ok(scan)"], "2 diagnoses, any one of which explains what was seen:"),
    ],
)
def test_the_first_line_is_the_answer(sentences: list[str], first: str) -> None:
    assert lines(*sentences, system=TEDUSAR)[0] == first


def test_what_is_cut_short_says_by_what_and_how_to_get_more() -> None:
    with WarmModel(TEDUSAR, options=Options(limit=1)) as model:
        shown = told(model.ask_line("not ok(scan)").result)
    assert shown[:4] == [
        "2 diagnoses, any one of which explains what was seen:",
        "",
        "  hokuyo",
        "  … and 1 more",
    ]
    assert shown[-1].startswith("incomplete: stopped by limit (see --limit); ")
    shown = told(result(complete=False, stopped_by="time"))
    assert shown[0] == "no diagnosis found: the search was stopped by time"


def test_independent_faults_are_told_as_products_with_their_exact_number() -> None:
    sentences = ("not ok(scan)", "not ok(odom)", "not running(rviz)")
    with WarmModel(TEDUSAR, options=Options(limit=2)) as model:
        shown = told(model.ask(model.question(sentences)).result)
    assert shown[0] == "4 diagnoses, any one of which explains what was seen; all blame rviz:"
    assert shown[2] == "  {jaguar, jaguar_node} × {hokuyo, hokuyo_node} × {rviz}"
    assert shown[-1].startswith("complete, as products; ")


def test_without_a_way_to_tell_them_apart_the_reason_is_said() -> None:
    twins = load_text(
        "robomend: 1\nhardware: {a: {}, b: {}}\nproperties: [p]\n"
        "rules: ['not ab(a) and not ab(b) -> ok(p)']\n"
    )
    with WarmModel(twins) as model:
        asked = model.question(["not ok(p)"])
        found = model.ask(asked).result
        shown = told(found, model.probes(asked, found, limit=3, timeout_s=5.0))
    assert "nothing to look at: everything that can be observed is observed already" in shown


def wide() -> Iterator[list[str]]:
    yield lines("not ok(cmd_vel)", "not ok(objects)", "not ok(joint_states)")
    yield told(result(" ".join(f"component_{number}" for number in range(1000))))
    yield told(result(*(f"{'x' * 70}_{number} y" for number in range(8))))
    assert MANIPULATOR.parts is not None
    yield lines(*(f"not running({node})" for node in MANIPULATOR.parts.nodes), everything=True)


def test_no_line_is_wider_than_a_terminal() -> None:
    for shown in wide():
        assert max(map(len, shown)) <= WIDTH
