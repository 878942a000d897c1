"""POST /models/{name}/isolability: what faults can show, over HTTP."""

from __future__ import annotations

import json

import pytest
from tests.api.conftest import Service

from robomend.cli.commands import run
from robomend.resources import resource
from robomend_client.rest import Client

TEDUSAR = str(resource("examples", "tedusar.yaml"))


def test_the_answer_is_that_of_the_command(service: Service, capsys: pytest.CaptureFixture[str]) -> None:
    service.with_robot("told")
    asked = {"observed": ["ok(odom)", "not ok(map)"], "double": True}
    found = service.api("POST", "/models/tedusar/isolability", json=asked).json()
    arguments = ["--isolability", "-o", "ok(odom)", "-o", "ok(map)", "--double", "--format", "json"]
    assert run(["model", "check", TEDUSAR, *arguments]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])  # before it: the service's log
    assert {**found, "elapsed_s": 0} == {**told, "elapsed_s": 0}
    assert [["jaguar"], ["jaguar_node"]] in [group["faults"] for group in found["groups"]]


def test_what_a_robot_reports_is_at_hand(service: Service) -> None:
    service.with_robot("seen", observed=["ok(scan)"])
    with Client(service.url) as client:
        found = client.isolability("tedusar", {"robot": "seen"})
    assert found["observed"] == ["ok(scan)"]
    more = {"robot": "seen", "observed": ["on(hokuyo)"]}
    found = service.api("POST", "/models/tedusar/isolability", json=more).json()
    assert found["observed"] == ["ok(scan)", "on(hokuyo)"]


def test_without_time_the_answer_says_so(service: Service) -> None:
    service.with_robot("late")
    found = service.api("POST", "/models/tedusar/isolability", json={"timeout_s": 1e-9}).json()
    assert not found["complete"]


@pytest.mark.parametrize(
    ("name", "body", "status", "words"),
    [
        ("nobody", {}, 404, "nobody"),
        ("tedusar", {"observed": ["ok(scam)"]}, 422, "scan"),
        ("tedusar", {"observed": ["ok(scan) or ok(map)"]}, 422, "nothing richer"),
        ("tedusar", {"robot": "r9"}, 404, "r9"),
        ("other", {"robot": "bad"}, 422, "follows the model tedusar"),
    ],
)
def test_bad_input_is_refused(
    service: Service, name: str, body: dict[str, object], status: int, words: str
) -> None:
    if service.api("GET", "/robots/bad").status_code == 404:
        service.with_robot("bad")
    source = {"source": "robomend: 1\nname: other\nnodes: {n: {publishes: {t: []}}}\n"}
    service.api("PUT", "/models/other", json=source)
    refused = service.api("POST", f"/models/{name}/isolability", json=body)
    assert refused.status_code == status
    assert words in refused.text
