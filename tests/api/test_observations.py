"""Observations come in: batches, streams, repeats; and nothing acknowledged is lost."""

from __future__ import annotations

import json
import time
from typing import Any

import pytest
from tests.api.conftest import Service
from tests.waiting import until

NDJSON = {"Content-Type": "application/x-ndjson"}
UNDECLARED = b'{"observations": ["ok(nothing)"]}\n'
LONG = b'{"observations": ["' + b"x" * 70_000 + b'"]}\n'


@pytest.fixture(autouse=True, scope="module")
def _robot(service: Service) -> None:
    service.with_robot("r1")


def literals(service: Service, robot: str = "r1") -> set[str]:
    """Return OBS as sentences."""
    found = service.api("GET", f"/robots/{robot}/observations").json()
    return {one["literal"] for one in found["observations"] if one["fresh"]}


def test_a_batch_is_accepted_and_said_back(service: Service) -> None:
    service.with_robot("batch")
    answer = service.observe("not ok (scan)", "on(/hokuyo) and running(rviz)", robot="batch")
    assert answer.json() == {
        "revision": 1,
        "changed": ["not ok(scan)", "on(hokuyo)", "running(rviz)"],
        "refused": [],
    }
    assert literals(service, "batch") == {"not ok(scan)", "on(hokuyo)", "running(rviz)"}


def test_a_bad_sentence_refuses_the_batch_or_only_itself(service: Service) -> None:
    service.with_robot("mixed")
    answer = service.observe("ok(map)", "ok(scna)", robot="mixed")
    assert (answer.status_code, answer.json()["code"]) == (422, "bad-observation")
    assert answer.json()["sentence"] == "ok(scna)"
    assert "scan" in answer.json()["detail"]
    assert literals(service, "mixed") == set()
    kept = service.observe("ok(map)", "ok(scna)", robot="mixed", together=False).json()
    assert kept["changed"] == ["ok(map)"]
    assert [one["sentence"] for one in kept["refused"]] == ["ok(scna)"]


def test_a_batch_that_contradicts_itself_is_refused_and_changes_nothing(service: Service) -> None:
    service.with_robot("torn")
    service.observe("ok(map)", robot="torn")
    answer = service.observe("not ok(map)", "ok(scan)", "ok(map)", robot="torn")
    assert answer.status_code == 422
    assert "both ok(map) and not ok(map)" in answer.json()["detail"]
    kept = service.observe("not ok(map)", "ok(map)", "ok(map)", together=False, robot="torn").json()
    assert [one["sentence"] for one in kept["refused"]] == ["ok(map)", "ok(map)"]
    assert kept["changed"] == ["not ok(map)"]


def test_names_that_nobody_declared_are_kept_where_the_robot_says_so(service: Service) -> None:
    service.with_robot("keeper", unknown="keep")
    service.observe("ok(never_heard_of)", robot="keeper")
    found = service.api("GET", "/robots/keeper/observations").json()["observations"]
    assert [(one["literal"], one["used"]) for one in found] == [("ok(never_heard_of)", False)]


def test_late_news_changes_nothing_and_the_future_is_refused(service: Service) -> None:
    service.with_robot("late")
    now = time.time_ns()
    service.observe("ok(scan)", robot="late", time=now)
    assert service.observe("not ok(scan)", robot="late", time=now - 10**9).json()["changed"] == []
    assert literals(service, "late") == {"ok(scan)"}
    answer = service.observe("not ok(scan)", robot="late", time=now + 3600 * 10**9)
    assert answer.status_code == 422
    assert "ahead" in answer.json()["detail"]


def test_a_literal_outlives_its_lifetime_as_unknown(service: Service) -> None:
    service.with_robot("mortal")
    service.observe("not ok(scan)", robot="mortal")
    assert service.diagnosis("mortal", wait_s=60, after=0)["result"]["diagnoses"][0]["bad"] == ["hokuyo"]
    service.observe("not ok(scan)", robot="mortal", lifetime_s=0.5)

    def bad() -> object:
        return service.diagnosis("mortal", wait_s=0.2)["result"]["diagnoses"][0]["bad"]

    until(lambda: bad() == [], "it is unknown", 60)
    assert literals(service, "mortal") == set()


def test_assertions_join_the_model_until_they_are_withdrawn(service: Service) -> None:
    service.with_robot("asserting")
    body = {"assertions": {"one of two": "not on(jaguar) or not on(hokuyo)"}}
    assert service.api("POST", "/robots/asserting/observations", json=body).status_code == 200
    found = service.diagnosis("asserting", wait_s=60, after=0)
    assert {tuple(one["bad"]) for one in found["result"]["diagnoses"]} == {("jaguar",), ("hokuyo",)}
    gone = service.api("DELETE", "/robots/asserting/assertions/one of two")
    assert gone.json()["revision"] == 2
    assert service.api("DELETE", "/robots/asserting/assertions/one of two").status_code == 404
    found = service.diagnosis("asserting", wait_s=60, after=1)
    assert found["result"]["diagnoses"][0]["bad"] == []


def test_a_repeat_with_the_same_key_has_the_first_effect_and_answer(service: Service) -> None:
    service.with_robot("once")
    body = {"observations": ["not ok(scan)"]}
    head = {"Idempotency-Key": "k1"}
    first = service.api("POST", "/robots/once/observations", json=body, headers=head)
    service.observe("ok(scan)", robot="once")
    again = service.api("POST", "/robots/once/observations", json=body, headers=head)
    assert again.json() == first.json()
    assert literals(service, "once") == {"ok(scan)"}
    other = service.api("POST", "/robots/once/observations", json={"observations": ["ok(map)"]}, headers=head)
    assert (other.status_code, other.json()["code"]) == (409, "idempotency-key-reused")


def test_ndjson_is_taken_in_as_it_streams(service: Service) -> None:
    service.with_robot("stream")
    start = time.time_ns()

    def lines() -> Any:
        for number in range(2500):
            word = "ok(scan)" if number % 2 else "not ok(scan)"
            yield json.dumps({"observations": [word], "time": start + number}).encode() + b"\n"
        yield b'{"observations": ["ok(map)"], "source": "last"}'

    answer = service.api("POST", "/robots/stream/observations", content=lines(), headers=NDJSON)
    assert answer.json() == {"revision": 3, "lines": 2501, "accepted": 2501}
    assert literals(service, "stream") == {"ok(scan)", "ok(map)"}


def test_a_bad_line_says_which_and_what_was_kept(service: Service) -> None:
    service.with_robot("broken")
    good = b'{"observations": ["ok(scan)"]}\n' * 1200
    for bad, status in ((b"{nonsense\n", 400), (UNDECLARED, 422), (b"[]\n", 422), (LONG, 413)):
        content = good + bad + good
        answer = service.api("POST", "/robots/broken/observations", content=content, headers=NDJSON)
        assert answer.status_code == status
        assert answer.json()["lines"] == 1000
        assert "first 1000 lines were kept" in answer.json()["detail"]
        if bad != UNDECLARED:  # a line that cannot be read is named; a sentence is found with its group
            assert answer.json()["detail"].startswith("line 1201:")


def test_an_endless_line_is_cut_off(service: Service) -> None:
    content = (b"x" * 10_000 for _ in range(50))
    answer = service.api("POST", "/robots/r1/observations", content=content, headers=NDJSON)
    assert answer.status_code == 413
