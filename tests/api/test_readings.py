"""What was measured beside an observation: taken in, kept, and shown wherever the literal is."""

from __future__ import annotations

import json
import time
from typing import Any

import pytest
from tests.api.conftest import TEDUSAR, Service, StartService
from tests.waiting import until

from robomend_client.readings import Reading, Symptom
from robomend_client.rest import Client

SILENT = Reading("0 of 10 Hz for 2.1 s", limit="10 ± 1 Hz", symptom=Symptom.SILENT)
LOW = Reading(19.1, "V", "at least 22", Symptom.VALUE)
SILENT_TEXT, LOW_TEXT = "0 of 10 Hz for 2.1 s, 10 ± 1 Hz", "19.1 V, at least 22"


def held(service: Service, robot: str) -> dict[str, Any]:
    """Return the text of what was measured of each literal of OBS; None: nothing."""
    found = service.api("GET", f"/robots/{robot}/observations").json()["observations"]
    return {one["literal"]: one["reading"] and one["reading"]["text"] for one in found}


def past(service: Service, robot: str) -> list[Any]:
    """Return the robot's history: batches and diagnoses."""
    pages = (
        service.api("GET", f"/robots/{robot}/history", params={"kind": kind}).json()
        for kind in ("observations", "diagnosis")
    )
    return [page["items"] for page in pages]


def told(service: Service, robot: str, count: int) -> list[dict[str, Any]]:
    """Return the data of the first events of a robot's observations."""
    with Client(service.url) as client:
        found = []
        for event in client.events(robot, after=0):
            if event.kind == "observations":
                found.append(dict(event.data))
                if len(found) == count:
                    return found
    raise AssertionError("the stream ended")


def test_a_reading_goes_with_its_literal_to_obs_history_and_events(service: Service) -> None:
    service.with_robot("read")
    with Client(service.url) as client:
        client.observe("read", ["not ok(scan)", "on(hokuyo)", "not on(jaguar)"], readings=[SILENT, None, LOW])
    assert held(service, "read") == {
        "not ok(scan)": SILENT_TEXT,
        "on(hokuyo)": None,
        "not on(jaguar)": LOW_TEXT,
    }
    found = service.api("GET", "/robots/read/observations").json()["observations"]
    [low] = [one["reading"] for one in found if one["literal"] == "not on(jaguar)"]
    expected = {"value": 19.1, "unit": "V", "limit": "at least 22", "symptom": "value", "text": LOW_TEXT}
    assert low == expected
    [line] = service.api("GET", "/robots/read/history").json()["items"]
    assert [one["reading"] and one["reading"]["text"] for one in line["data"]["observations"]] == [
        SILENT_TEXT,
        None,
        LOW_TEXT,
    ]
    [event] = told(service, "read", 1)
    assert {literal: one["text"] for literal, one in event["readings"].items()} == {
        "not ok(scan)": SILENT_TEXT,
        "not on(jaguar)": LOW_TEXT,
    }


def test_a_repetition_renews_the_reading_and_changes_nothing_else(service: Service) -> None:
    service.with_robot("again")
    first = service.observe("not ok(scan)", robot="again", lifetime_s=60, readings=[{"value": "5 Hz"}]).json()
    until(lambda: past(service, "again")[1][0]["data"]["revision"] == 1, "the diagnosis is published")
    before = past(service, "again")
    more = service.observe("not ok(scan)", robot="again", lifetime_s=60, readings=[{"value": "4 Hz"}]).json()
    assert (more["revision"], more["changed"]) == (first["revision"], [])
    assert held(service, "again") == {"not ok(scan)": "4 Hz"}
    assert past(service, "again") == before
    service.observe("not ok(scan)", robot="again", lifetime_s=60)
    assert held(service, "again") == {"not ok(scan)": None}  # the newest report says none


@pytest.mark.parametrize("lifetime_s", [None, 3600])
def test_the_newest_reading_is_there_after_a_restart(start: StartService, lifetime_s: float | None) -> None:
    service = start()
    service.with_robot("r1")
    for value in ("5 Hz", "4 Hz", 3.5):
        service.observe("not ok(scan)", lifetime_s=lifetime_s, readings=[{"value": value, "unit": "<b>"}])
    service.observe("ok(map)", lifetime_s=lifetime_s)
    again = start()
    assert held(again, "r1") == {"not ok(scan)": "3.5 <b>", "ok(map)": None}


def test_lines_of_a_stream_have_readings_too(service: Service) -> None:
    service.with_robot("lines")
    lines = [
        {"observations": ["not ok(scan)"], "time": time.time_ns(), "readings": [{"value": 2, "unit": "Hz"}]},
        {
            "observations": ["ok(map)", "ok(odom)"],
            "time": time.time_ns(),
            "readings": [None, {"value": "49 Hz"}],
        },
    ]
    body = "".join(json.dumps(line) + "\n" for line in lines)
    headers = {"Content-Type": "application/x-ndjson"}
    answer = service.api("POST", "/robots/lines/observations", content=body, headers=headers)
    assert answer.status_code == 200
    assert held(service, "lines") == {"not ok(scan)": "2 Hz", "ok(map)": None, "ok(odom)": "49 Hz"}


def test_a_sentence_of_two_literals_has_one_reading_for_both(service: Service) -> None:
    service.with_robot("both")
    service.observe("not ok(scan) and not ok(map)", robot="both", readings=[{"value": "host pc2 is down"}])
    assert held(service, "both") == dict.fromkeys(("not ok(scan)", "not ok(map)"), "host pc2 is down")


@pytest.mark.parametrize(
    ("readings", "words"),
    [
        ([None, None], "readings: 2 values for 1 observations; give one for each, null where there is none"),
        ([{"value": "x" * 501}], "readings.0.value: Value error, a text of 501 characters; 500 are taken"),
        ([{"value": 1, "symptom": "loud"}], "readings.0.symptom: Input should be 'silent', 'slow'"),
        ([{"value": "a\x1b[31m"}], "character 1 is a control character ('\\x1b'); put a space"),
        ([{"value": 1, "unit": "\u202eV"}], "readings.0.unit: Value error, character 0"),
        ([{"value": "half \ud800"}], "half a surrogate pair"),
        ([{"value": True}], "readings.0.value: Value error, a number or a text is wanted"),
        ([{"unit": "V"}], "readings.0.value: Field required"),
        (
            [{"value": 1, "units": "V"}],
            "readings.0.units: Extra inputs are not permitted; did you mean 'unit'?",
        ),
        ({"value": 1}, "readings: Input should be a valid list"),
    ],
)
def test_what_is_no_reading_is_refused_with_its_place(service: Service, readings: Any, words: str) -> None:
    service.api("PUT", "/models/tedusar", json={"source": TEDUSAR})
    service.api("PUT", "/robots/refused", json={"model": "tedusar"})
    body = json.dumps({"observations": ["not ok(scan)"], "readings": readings})
    headers = {"Content-Type": "application/json"}
    answer = service.api("POST", "/robots/refused/observations", content=body, headers=headers)
    assert answer.status_code == 422
    assert words in answer.json()["detail"], answer.json()["detail"]
    assert held(service, "refused") == {}


def test_markup_is_text(service: Service) -> None:
    service.with_robot("markup")
    text = "<script>alert(1)</script> & \"'"
    service.observe("not ok(scan)", robot="markup", readings=[{"value": text}])
    assert held(service, "markup") == {"not ok(scan)": text}
    page = service.http.get("/ui/robots/markup").text
    assert "<script>alert" not in page
    assert "&lt;script&gt;alert(1)&lt;/script&gt; &amp; &#34;&#39;" in page
