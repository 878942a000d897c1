"""What agents send and get, as docs/observers.md shows it: the service takes it, and the client reads it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import httpx
from tests.api.conftest import Service

from robomend.api.schemas.observations import OBSERVATIONS as BATCH
from robomend.api.schemas.repair import PollBody
from robomend_client.actions import Action, Orders, Settle
from robomend_client.rest import calls

MANUAL = (Path(__file__).parents[2] / "docs" / "observers.md").read_text()
OBSERVATIONS, POLL, ORDERS = map(json.loads, re.findall(r"```json\n(.*?)```", MANUAL, re.DOTALL))


def test_every_key_of_the_manual_is_one_of_the_wire() -> None:
    assert set(OBSERVATIONS) | {"assertions", "together"} == BATCH.json_schema()["properties"].keys()
    assert set(POLL) == set(PollBody.model_fields)


def test_the_client_sends_what_the_manual_shows() -> None:
    batch = {key: value for key, value in OBSERVATIONS.items() if key not in ("observations", "time")}
    call = calls.observe("r1", OBSERVATIONS["observations"], time_ns=OBSERVATIONS["time"], **batch)
    assert call.json == OBSERVATIONS
    assert calls.poll("r1", **POLL).json == POLL


def test_the_client_reads_the_answer_that_the_manual_shows() -> None:
    def read(value: Any) -> Orders:
        return calls.read_orders(httpx.Response(200, json=value, request=httpx.Request("POST", "http://s")))

    settle = Settle(7, ("ok(scan)", "running(hokuyo_node)"))
    action = Action("r-7k2m9x4q:2", "start_node", ("hokuyo_node",), 10)
    assert read(ORDERS) == Orders(action, settle)
    assert read({"settle": ORDERS["settle"]}) == Orders(None, settle)
    assert read({name: value for name, value in ORDERS.items() if name != "settle"}) == Orders(action)


def test_evidence_is_taken_with_a_batch_and_refused_in_another_shape(service: Service) -> None:
    service.with_robot("evidence")
    changed: list[dict[str, Any]] = [
        {},
        {"observations": [], "since": [], "onset": [], "readings": []},
        {"since": [None, None]},
    ]
    for more in changed:
        batch = OBSERVATIONS | more | {"together": False}
        answer = service.api("POST", "/robots/evidence/observations", json=batch)
        assert answer.status_code == 200, answer.text
    for wrong in (
        {"since": [-1, 0]},
        {"since": [OBSERVATIONS["time"] + 1, None]},  # after the batch's own time
        {"since": [None, 2**62]},  # in the future
        {"since": ["now"]},
        {"onset": [1.5]},
        {"unknown": "ok(scan)"},
        {"settled": -1},
    ):
        answer = service.api("POST", "/robots/evidence/observations", json=OBSERVATIONS | wrong)
        assert (answer.status_code, answer.json()["code"]) == (422, "bad-input")
