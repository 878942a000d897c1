"""The routes of repair and actions translate and delegate: what was asked is what the loop is told."""

from __future__ import annotations

from typing import Any

import pytest
from tests.api.conftest import Service, StartService, sign_in


@pytest.fixture(autouse=True, scope="module")
def _robot(service: Service) -> None:
    service.with_robot("r1")


def test_plans_and_repairs(service: Service) -> None:
    calls: list[Any] = service.repairs.calls
    service.api("POST", "/robots/r1/plans", json={"bad": ["jaguar"], "timeout_s": 2})
    assert calls[-1] == ("plan", "r1", ["jaguar"], None, 2.0, False)
    made = service.api("POST", "/robots/r1/repairs", json={"reason": "it limps"})
    assert (made.status_code, made.headers["location"]) == (202, "/api/v1/repairs/r-1")
    assert calls[-1] == ("create", "r1", None, "local", "it limps")
    service.api("GET", "/robots/r1/repairs", params={"limit": 1, "cursor": "r-9"})
    assert calls[-1] == ("repairs", "r1", "r-9", 1)
    for decision, state in (("approve", "running"), ("cancel", "cancelled")):
        answer = service.api("POST", "/repairs/r-1", json={"decision": decision, "reason": "so"})
        assert answer.json()["state"] == state
        assert calls[-1] == (decision, "r-1", "local", "so")
    assert service.api("POST", "/repairs/r-1", json={"decision": "maybe"}).status_code == 422
    assert service.api("POST", "/repairs/none", json={"decision": "cancel"}).status_code == 404


def test_an_agent_pulls_its_action_and_reports(service: Service) -> None:
    loop = service.repairs
    calls: list[Any] = loop.calls
    ask = {"agent": "onboard", "host": "pc", "wait_s": 5}
    assert service.api("POST", "/robots/r1/actions/next", json={"agent": "onboard"}).status_code == 204
    action = {"id": "r-1:2", "name": "start_node", "parameters": ["rviz"], "timeout_s": 5.0, "host": "pc"}
    loop.queue["r1"] = action
    loop.owners["r-1:2"] = "r1"
    asked = service.api("POST", "/robots/r1/actions/next", json=ask)
    assert asked.json() == action
    assert calls[-1] == ("orders", "r1", "onboard", "pc", None, 5.0)
    poll = {"agent": "onboard", "host": "pc", "can": ["start_node:rviz"], "wait_s": 5}
    poll["observes"] = [{"atom": "running(rviz)", "detection_s": 0.1, "settling_s": 0.1}]
    assert service.api("POST", "/robots/r1/actions/next", json=poll).json() == action
    assert calls[-1] == ("orders", "r1", "onboard", "pc", ["start_node:rviz"], 5.0)
    assert service.api("POST", "/robots/r1/actions/next", json={"host": "pc"}).status_code == 422
    told = service.api("POST", "/actions/r-1:2/feedback", json={"code": 50, "message": "half"})
    assert told.status_code == 204
    assert calls[-1] == ("feedback", "r-1:2", 50, "half")
    first = service.api("POST", "/actions/r-1:2/result", json={"code": 0}).json()
    again = service.api("POST", "/actions/r-1:2/result", json={"code": 1, "message": "late"}).json()
    assert first == again == {"code": 0, "message": ""}
    assert service.api("POST", "/actions/r-1:9/result", json={"code": 0}).status_code == 404


def test_no_get_takes_an_action_unless_a_key_is_in_its_header(start: StartService) -> None:
    service = start()
    service.with_robot("r1")
    action = {"id": "r-1:2", "name": "start_node", "parameters": ["rviz"], "timeout_s": 5.0, "host": "pc"}
    service.repairs.queue["r1"] = action
    refused = service.api("GET", "/robots/r1/actions/next")
    assert (refused.status_code, refused.headers["allow"]) == (405, "POST")
    key = service.key("robot", "r1")
    cookie = sign_in(service, key).headers["set-cookie"].partition(";")[0]
    head = {"Cookie": cookie, "Origin": service.url}
    assert service.api("GET", "/robots/r1/actions/next", headers=head).status_code == 405
    assert ("next_action", "r1", None, 0.0) not in service.repairs.calls
    taken = service.api("GET", "/robots/r1/actions/next", headers={"Authorization": f"Bearer {key}"})
    assert taken.json() == action
    assert taken.headers["deprecation"] == "true"
