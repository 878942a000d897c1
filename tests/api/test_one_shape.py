"""One result has one shape: whoever asks, and by whichever door, reads the same JSON."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from typing import Any

import pytest
from tests.api.conftest import TEDUSAR, Service
from tests.api.test_events import following, take

from robomend.api.schemas.base import Out
from robomend.api.schemas.diagnosis import ConflictOut, DiagnosisOut, FactorOut, ResultOut
from robomend.cli.commands import run
from robomend.diagnosis.result import Conflict, Diagnosis, DiagnosisResult, Factor
from robomend.oneshots.result_json import result_json
from robomend.resources import resource
from robomend_client.literals import fails

MANIPULATOR = resource("examples", "mobile_manipulator.yaml").read_text(encoding="utf-8")

QUESTIONS = {
    "healthy": (TEDUSAR, ["ok(scan)", "running(rviz)"]),
    "one conflict": (TEDUSAR, ["not ok(map)"]),
    "several": (TEDUSAR, ["not ok(scan)", "not ok(odom)", "not running(rviz)", "ok(joy)"]),
    "premises": (TEDUSAR, ["not ok(cmd_vel)", "ok(joy)", "not running(imu_node)", "not ok(imu_data)"]),
    "richer": (TEDUSAR, ["not ok(scan) or not ok(odom)", "ok(odom)"]),
    "long": (f"{TEDUSAR}# {'long ' * 1000}\n", ["not ok(scan) or not ok(odom)", "ok(odom)"]),
    "priors": (MANIPULATOR, ["not ok(scan_front)", "not running(move_group)"]),
    "no rule mentions it": (f"{TEDUSAR}properties: {{lamp: {{}}}}\n", ["not ok(scan)", "ok(lamp)"]),
}


def timeless(answer: dict[str, Any]) -> dict[str, Any]:
    """Return an answer without what differs from one diagnosis or plan to the next."""
    assert answer["elapsed_s"] >= 0
    return {**answer, "elapsed_s": None}


def from_command(
    source: str, sentences: list[str], capsys: pytest.CaptureFixture[str], *more: str, name: str = "diagnose"
) -> dict[str, Any]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.stdin", io.StringIO(source))
        observed = [word for sentence in sentences for word in ("-o", sentence)]
        assert run([name, "-", *observed, "--format", "json", *more]) == 0
    lines = capsys.readouterr().out.splitlines()  # the service's log is there as well
    found: dict[str, Any] = next(json.loads(line) for line in lines if line.startswith("{"))
    return found


def from_robot(service: Service, robot: str, source: str, sentences: list[str]) -> None:
    """Have a robot that was seen so, and diagnosed."""
    service.api("PUT", f"/models/{robot}", json={"source": source})
    assert service.api("PUT", f"/robots/{robot}", json={"model": robot}).status_code == 201
    richer = {f"said {i}": one for i, one in enumerate(sentences) if " or " in one}
    literals = [one for one in sentences if " or " not in one]
    body = {"observations": literals, "assertions": richer}
    assert service.api("POST", f"/robots/{robot}/observations", json=body).status_code == 200


def diagnoses(events: Iterator[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    while True:
        yield take(events, "diagnosis", 1)[0]["data"]["data"]


@pytest.mark.parametrize("name", QUESTIONS)
def test_a_result_reads_the_same_by_every_door(
    name: str, service: Service, capsys: pytest.CaptureFixture[str]
) -> None:
    source, sentences = QUESTIONS[name]
    told = timeless(from_command(source, sentences, capsys))
    posted = service.api("POST", "/diagnoses", json={"source": source, "observations": sentences})
    assert timeless(posted.json()) == told
    robot = name.replace(" ", "-")
    from_robot(service, robot, source, sentences)
    current = service.diagnosis(robot, after=0, wait_s=60)["result"]
    assert timeless(current) == told
    said = 0 if name == "healthy" else 1  # a diagnosis that says the same as the one before is no event
    with following(service, f"/robots/{robot}/events", last="0") as events:
        event = next(one for one in diagnoses(events) if one["revision"] == said)
    assert timeless(event["result"]) == told
    page = service.api("GET", f"/robots/{robot}/history", params={"kind": "diagnosis"}).json()
    assert timeless(page["items"][0]["data"]["result"]) == told
    assert {*told} == {*ResultOut.model_fields}


@pytest.mark.parametrize(
    ("sentences", "bad"),
    [
        (["not on(jaguar)"], None),
        (["on(jaguar) and running(jaguar_node)", "not ok(odom)"], None),
        (["ok(scan)"], None),
        ([], ["hokuyo", "rviz"]),
    ],
)
def test_a_plan_reads_the_same_by_the_command_and_over_http(
    sentences: list[str], bad: list[str] | None, service: Service, capsys: pytest.CaptureFixture[str]
) -> None:
    named = [word for one in bad or () for word in ("--bad", one)]
    told = from_command(TEDUSAR, sentences, capsys, "--planner", "asp", *named, name="plan")
    body = {"source": TEDUSAR, "observations": sentences, "planner": "asp", "bad": bad}
    posted = service.api("POST", "/plans", json=body)
    assert posted.status_code == 200, posted.text
    answer = posted.json()
    for one in (told, answer):
        if one["plan"] is not None:
            one["plan"] = timeless(one["plan"])
    assert answer == told


FULL = DiagnosisResult(
    ("a", "b"),
    (Diagnosis(("a",), 0.5, {"a": "stuck"}, (0,)),),
    True,
    None,
    (Conflict(("a",), (fails("ok", "x"),), ("rule",), "text", fails("ok", "x")),),
    0.25,
    (fails("on", "y"),),
    ((Factor("a", ("a", "b"), (("c", "d"),)),),),
    1,
    0.1,
    {"b": "why"},
)


def test_every_field_of_a_result_is_described_in_openapi() -> None:
    values = result_json(FULL)
    described: list[tuple[dict[str, Any], type[Out]]] = [
        (values, ResultOut),
        (values["diagnoses"][0], DiagnosisOut),
        (values["conflicts"][0], ConflictOut),
        (values["factored"][0][0], FactorOut),
    ]
    for found, schema in described:
        assert [*found] == [*schema.model_fields]
        assert all(found.values()) or found is values
    assert ResultOut.model_validate(values).model_dump() == values
