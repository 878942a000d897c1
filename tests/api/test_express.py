"""The short way of POST …/observations answers as the framework's way does, request by request."""

from __future__ import annotations

import json
import re
from typing import Any

import httpx
import pytest
from tests.api.conftest import Service, StartService

from robomend.api.ingestion import Express

JSON = {"Content-Type": "application/json"}
LONG = {"Content-Type": "application/json; charset=utf-8"}
"""The same kind of body; a parameter is enough for the framework's way."""

BODIES: dict[str, bytes] = {
    "plain": b'{"observations": ["not ok(scan)"]}',
    "all fields": json.dumps(
        {
            "observations": ["ok(map)"],
            "assertions": {"a": "ok(map) or ok(scan)"},
            "time": 1_700_000_000_000_000_000,
            "source": "s",
            "lifetime_s": 5,
            "together": False,
        }
    ).encode(),
    "nothing": b"",
    "no JSON": b"{",
    "no object": b"[]",
    "wrong field": b'{"observation": []}',
    "wrong type": b'{"observations": [1]}',
    "empty sentence": b'{"observations": [""]}',
    "unknown name": b'{"observations": ["ok(nothing)"]}',
    "malformed sentence": b'{"observations": ["ok((scan)"]}',
    "too deep": b"[" * 100 + b"]" * 100,
    "not UTF-8": b'{"observations": ["\xff"]}',
    "NaN": b'{"observations": [], "time": NaN}',
    "a repeated key": b'{"observations": [], "observations": []}',
    "far ahead": b'{"observations": ["ok(map)"], "time": 9000000000000000000}',
}


def test_only_plain_requests_take_the_short_way(observed: Service) -> None:
    route = next(r for r in observed.runtime.app.routes if getattr(r, "path", "").endswith("/observations"))
    express = Express(observed.runtime.app.state.parts, observed.runtime.app.state.gate, route)

    def takes(method: str, path: str, **headers: str) -> bool:
        given = [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()]
        return express.takes({"type": "http", "method": method, "path": path, "headers": given})

    there, json_body = "/api/v1/robots/r1/observations", "application/json"
    assert takes("POST", there, content_type=json_body)
    assert takes("POST", there, content_type=json_body, idempotency_key="k")
    assert not takes("POST", there, content_type=json_body, idempotency_key="two words")
    assert not takes("POST", there, content_type="application/x-ndjson")
    assert not takes("POST", there)
    assert not takes("GET", there, content_type=json_body)
    assert not takes("POST", there + "/", content_type=json_body)
    assert not takes("POST", "/api/v1/robots/r 1/observations", content_type=json_body)


def told(answer: httpx.Response) -> tuple[int, str, Any]:
    """Return what a client sees, but for what differs between any two requests."""
    body = answer.json() if answer.content else None
    if isinstance(body, dict):
        body = {name: value for name, value in body.items() if name not in {"request_id", "revision"}}
        if "detail" in body:  # the clock goes on between them
            body["detail"] = re.sub(r"\b\d+ s ahead", "some s ahead", body["detail"])
    return answer.status_code, answer.headers["content-type"], body


@pytest.fixture(scope="module")
def observed(service: Service) -> Service:
    """A service with two robots that are posted to in step."""
    service.with_robot("short")
    made = service.api("PUT", "/robots/long", json={"model": "tedusar"})
    assert made.status_code == 201
    return service


PLAIN = BODIES["plain"]
REQUESTS: dict[str, tuple[bytes, dict[str, str], int | None]] = {
    **{name: (body, {}, None) for name, body in BODIES.items()},
    "another origin": (PLAIN, {"Origin": "http://elsewhere.example"}, 403),
    "another host": (PLAIN, {"Host": "elsewhere.example"}, 421),
    "an ill-formed key": (PLAIN, {"Idempotency-Key": "two words"}, 422),
}
"""Body, headers, and the status where the body does not decide."""


@pytest.mark.parametrize("name", REQUESTS)
def test_a_request_has_the_same_answer_on_both_ways(observed: Service, name: str) -> None:
    body, headers, status = REQUESTS[name]
    answers = [
        observed.api("POST", f"/robots/{robot}/observations", content=body, headers=kind | headers)
        for robot, kind in (("short", JSON), ("long", LONG))
    ]
    assert told(answers[0]) == told(answers[1])
    assert status in {None, answers[0].status_code}


def test_a_robot_that_is_not_there_is_not_found_on_both_ways(observed: Service) -> None:
    answers = [
        observed.api("POST", "/robots/nobody/observations", content=PLAIN, headers=kind)
        for kind in (JSON, LONG)
    ]
    assert told(answers[0]) == told(answers[1])
    assert answers[0].status_code == 404


def test_a_key_has_its_first_answer_whichever_way_the_repeat_takes(observed: Service) -> None:
    body = b'{"observations": ["not ok(odom)"]}'
    first, again = (
        observed.api(
            "POST", "/robots/short/observations", content=body, headers=kind | {"Idempotency-Key": "k-1"}
        )
        for kind in (JSON, LONG)
    )
    assert first.json() == again.json()


def test_roles_hold_on_the_short_way(start: StartService) -> None:
    service = start()
    service.with_robot("r1")
    keys = {role: service.key(role) for role in ("viewer", "operator")}
    keys |= {"own": service.key("robot", "r1"), "other": service.key("robot", "r2"), "none": ""}

    def status(key: str) -> int:
        head = JSON | ({"Authorization": f"Bearer {key}"} if key else {})
        return service.api("POST", "/robots/r1/observations", content=PLAIN, headers=head).status_code

    statuses = {name: status(key) for name, key in keys.items()}
    assert statuses == {"viewer": 403, "operator": 200, "own": 200, "other": 403, "none": 401}


def test_metrics_name_the_route_on_both_ways(observed: Service) -> None:
    observed.observe("ok(odom)", robot="short")
    text = observed.http.get("/metrics").text
    line = next(
        line for line in text.splitlines() if "requests_total" in line and "POST" in line and "200" in line
    )
    assert '"/api/v1/robots/{robot}/observations"' in line
