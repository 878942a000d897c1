"""Whatever comes in, the answer is a problem with a stable code, never a 500, by either way of a report."""

from __future__ import annotations

import json
import re
from typing import Any

import httpx
import pytest
from tests.api.conftest import Service, StartService
from tests.waiting import until

from robomend.api.ingestion import Express

JSON = {"Content-Type": "application/json"}
JSON_TOO = {"Content-Type": "application/json; charset=utf-8"}
"""The same kind of body; with a parameter it takes the framework's way, and not the short one."""

PLACE = "/robots/r1/observations"


@pytest.fixture(autouse=True, scope="module")
def _robot(service: Service) -> None:
    service.with_robot("r1")
    service.with_robot("short")
    assert service.api("PUT", "/robots/long", json={"model": "tedusar"}).status_code == 201


def alike(answer: httpx.Response) -> tuple[int, str, Any]:
    """Return what a client sees, but for what differs between any two requests."""
    body = {name: value for name, value in answer.json().items() if name not in {"request_id", "revision"}}
    if "detail" in body:  # the clock goes on between them
        body["detail"] = re.sub(r"\b\d+ s ahead", "some s ahead", body["detail"])
    return answer.status_code, answer.headers["content-type"], body


@pytest.mark.parametrize(
    ("method", "place", "body", "said"),
    [
        ("POST", PLACE, {"obsrevations": []}, "body.obsrevations: {}; did you mean 'observations'?"),
        (
            "PUT",
            "/robots/r9",
            {"model": "tedusar", "polcy": "auto"},
            "body.polcy: {}; did you mean 'policy'?",
        ),
        (
            "PUT",
            "/robots/r9",
            {"model": "tedusar", "actions": {"start": {"executor": {"kind": "agent", "option": {}}}}},
            "body.actions.start.executor.option: {}; did you mean 'options'?",
        ),
        (
            "PUT",
            "/robots/r9",
            {"model": "tedusar", "windows": [{"start": "22:00", "end": "05:30", "weekday": [1]}]},
            "body.windows.0.weekday: {}; did you mean 'weekdays'?",
        ),
        (
            "PUT",
            "/models/m",
            {"source": "robomend: 1", "sauce": ""},
            "body.sauce: {}; did you mean 'source'?",
        ),
        ("POST", "/batches", {"logs": [], "modle": "m"}, "body.modle: {}; did you mean 'model'?"),
        ("POST", PLACE, {"observations": [], "colour": 1}, "body.colour: {}"),
    ],
    ids=lambda value: str(value)[:30],
)
def test_an_unknown_field_is_refused_with_the_one_that_was_meant(
    method: str, place: str, body: dict[str, Any], said: str, service: Service
) -> None:
    answer = service.api(method, place, json=body)
    assert answer.status_code == 422
    faults = [f"{fault['place']}: {fault['message']}" for fault in answer.json()["errors"]]
    assert said.format("Extra inputs are not permitted") in faults


@pytest.mark.parametrize(
    ("body", "status", "code"),
    [
        (b"", 400, "malformed-json"),
        (b"{", 400, "malformed-json"),
        (b'{"observations": [NaN]}', 400, "malformed-json"),
        (b'{"assertions": {"a": "ok(scan)", "a": "ok(odom)"}}', 400, "malformed-json"),
        (b'{"lifetime_s": 1e999}', 422, "bad-input"),
        (b'{"observations": ["\xff\xfe"]}', 400, "malformed-json"),
        (b'{"observations": ["\\ud800"]}', 422, "bad-input"),
        (b'{"observations": ["ok(a\\u0000b)"]}', 422, "bad-input"),
        (b'{"time": ' + b"9" * 5000 + b"}", 422, "bad-input"),
        (b'{"time": 99999999999999999999999}', 422, "bad-input"),
        (b'{"observations": ["ok(scan)"], "time": true}', 422, "bad-input"),
        (b"[" * 100_000, 422, "too-deep"),
        (b'{"observations": [1]}', 422, "bad-input"),
        (b'{"observations": [""]}', 422, "bad-input"),
        (b"[]", 422, "bad-input"),
        (b'{"observations": ["ok("]}', 422, "bad-observation"),
        (b'{"observations": ["ab(jaguar)"]}', 422, "bad-observation"),
        (b'{"observations": ["on(jaguar)", "ok(scan)", "not ok(scan)"]}', 422, "bad-observation"),
        (b'{"observations": ["' + b"(" * 3000 + b'"]}', 422, "bad-observation"),
        (b'{"observations": ["' + b"[" * 100 + b'"]}', 422, "bad-observation"),  # in a text it is no depth
        (b'{"observations": ["ok(nothing)"]}', 422, "bad-observation"),
        (b'{"observations": ["ok(scan)"], "time": 9000000000000000000}', 422, "bad-input"),
    ],
    ids=lambda value: str(value)[:30],
)
def test_a_malformed_body_is_told_apart_and_alike_on_both_ways(
    service: Service, body: bytes, status: int, code: str
) -> None:
    short, long = (service.api("POST", PLACE, content=body, headers=kind) for kind in (JSON, JSON_TOO))
    assert (short.status_code, short.json()["code"]) == (status, code)
    assert short.headers["content-type"] == "application/problem+json"
    assert short.json()["request_id"] == short.headers["x-request-id"]
    assert alike(short) == alike(long)


@pytest.mark.parametrize(
    ("path", "body", "status"),
    [
        ("/repairs/r-1", {"decision": "maybe"}, 422),
        ("/repairs/none", {"decision": "cancel"}, 404),
        ("/actions/r-1:9/result", {"code": 0}, 404),
        ("/robots/r1/actions/next", {"host": "pc"}, 422),
    ],
)
def test_a_decision_or_an_answer_that_is_none(
    service: Service, path: str, body: dict[str, Any], status: int
) -> None:
    assert service.api("POST", path, json=body).status_code == status


@pytest.mark.parametrize("path", ["/repairs/r-1", "/changes/c-1"])
@pytest.mark.parametrize(("decision", "state"), [("approve", "running"), ("cancel", "cancelled")])
def test_a_decision_that_is_one_is_taken(service: Service, path: str, decision: str, state: str) -> None:
    assert service.api("POST", path, json={"decision": decision}).json()["state"] == state


@pytest.mark.parametrize("kind", ["text/plain", "application/xml", "multipart/form-data", ""])
@pytest.mark.parametrize("path", [PLACE, "/stop"])
def test_another_kind_of_body_is_a_415(service: Service, kind: str, path: str) -> None:
    answer = service.api("POST", path, content=b"{}", headers={"Content-Type": kind})
    assert (answer.status_code, answer.json()["code"]) == (415, "unsupported-media-type")


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("GET", "/nothing", 404),
        ("GET", "/robots/none", 404),
        ("GET", "/robots/none/diagnosis", 404),
        ("GET", "/repairs/none", 404),
        ("GET", "/changes/c-9", 404),
        ("GET", "/models/none/versions", 404),
        ("GET", "/robots/r1/board", 404),
        ("PATCH", "/robots/r1", 405),
        ("GET", "/robots/%00", 422),
        ("GET", "/robots/a%2Fb", 404),
        ("GET", "/robots/" + "x" * 100, 422),
        ("GET", "/robots?limit=0", 422),
        ("GET", "/audit?cursor=nonsense", 422),
        ("GET", "/robots/r1/history?kind=other", 422),
        ("GET", "/robots/r1/diagnosis?wait_s=nan", 422),
        ("GET", "/robots/r1/diagnosis?after=99999999999999999999", 422),
        ("DELETE", "/robots/r1/assertions/none", 404),
        ("DELETE", "/robots/r1", 428),
    ],
)
def test_a_place_or_a_query_that_is_none(service: Service, method: str, path: str, status: int) -> None:
    answer = service.api(method, path)
    assert answer.status_code == status, answer.text
    assert set(answer.json()) >= {"type", "title", "status", "code", "detail"}


def test_a_body_beyond_its_limit_is_a_413_before_it_is_read(start: StartService) -> None:
    service = start(max_body_bytes=2000, max_model_bytes=3000)
    service.http.timeout = 20
    answer = service.api("POST", "/stop", content=b" " * 5000, headers=JSON)
    assert (answer.status_code, answer.json()["code"]) == (413, "too-large")
    chunks = (b" " * 500 for _ in range(100))  # without a length: cut off on the way
    assert service.api("POST", "/stop", content=chunks, headers=JSON).status_code == 413
    answer = service.api("PUT", "/models/m", json={"source": "# " + "x" * 3500})
    assert (answer.status_code, answer.json()["code"]) == (413, "too-large")


def test_a_model_with_too_many_parts_is_refused(start: StartService) -> None:
    service = start(max_components=3)
    source = "robomend: 1\nname: many\nhardware: {a: {}, b: {}, c: {}, d: {}}\nnodes: {}\n"
    answer = service.api("PUT", "/models/many", json={"source": source})
    assert (answer.status_code, answer.json()["code"]) == (413, "too-large")


def test_a_yaml_bomb_is_refused(service: Service) -> None:
    bomb = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
        f"{chr(98 + n)}: &{chr(98 + n)} [{','.join(['*' + chr(97 + n)] * 9)}]\n" for n in range(20)
    )
    for source in (
        bomb,
        "a: &a [*a]\n",
        "[" * 5000,
        "robomend: 1\n" * 3,
        "\x00",
        "!!python/object:os.system x",
    ):
        answer = service.api("PUT", "/models/bomb", json={"source": source})
        assert answer.status_code == 422, source[:30]


def test_a_body_that_stalls_is_given_up(start: StartService) -> None:
    service = start(body_timeout_s=0.2)
    with service.connect() as slow:
        slow.sendall(
            b"POST /api/v1/stop HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
            b"Content-Length: 100\r\n\r\n{"
        )
        assert slow.recv(1000).startswith(b"HTTP/1.1 408 ")


def test_too_many_requests_are_told_when_to_come_back(start: StartService) -> None:
    service = start(requests_per_s=0.05, burst=3)
    answers = [service.api("GET", "/robots") for _ in range(4)]
    assert [answer.status_code for answer in answers] == [200, 200, 200, 429]
    assert answers[-1].json()["code"] == "too-many-requests"
    assert int(answers[-1].headers["retry-after"]) >= 1
    assert service.http.get("/healthz").status_code == 200


def test_a_secret_is_not_said_back(service: Service) -> None:
    key = "rm_" + "s" * 43
    answer = service.api("GET", "/robots", headers={"Authorization": f"Bearer {key}"})
    assert answer.status_code == 401
    assert key not in answer.text


def test_a_reason_is_one_line_that_shows_as_it_reads(service: Service) -> None:
    """It stands beside others' in lists and logs; the stop is taken all the same, whatever its reason."""
    told, shown = (
        "smoke\r\n2026 stop lifted by ann\u202egnp.exe\x1b[2J",
        "smoke  2026 stop lifted by ann?gnp.exe?[2J",
    )
    assert service.api("POST", "/stop", json={"reason": told}).json()["reason"] == shown
    assert service.api("DELETE", "/stop", params={"reason": told}).status_code in {200, 202}
    until(lambda: not service.api("GET", "/stop").json()["active"], "it was not lifted")
    trail = [entry for entry in service.api("GET", "/audit").json()["items"] if "stop" in entry["action"]]
    assert {entry["reason"] for entry in trail} == {shown}


def test_whoever_leaves_while_it_waits_is_no_fault_of_the_service(service: Service) -> None:
    with pytest.raises(httpx.ReadTimeout):
        service.api("GET", "/robots/r1/diagnosis", params={"wait_s": 60}, timeout=0.5)
    counted = 'route="/api/v1/robots/{robot}/diagnosis",status="%d"'
    until(lambda: counted % 499 in service.http.get("/metrics").text, "it is counted as gone")
    assert counted % 500 not in service.http.get("/metrics").text


def test_a_bug_of_ours_is_answered_with_a_problem_and_nothing_of_it(
    start: StartService, monkeypatch: pytest.MonkeyPatch
) -> None:
    service = start()

    async def breaks(*_: object, **__: object) -> None:
        raise RuntimeError("secret of the inside")

    monkeypatch.setattr(service.runtime.robots, "diagnosed", breaks)
    answer = service.api("GET", "/robots/r1")
    assert answer.status_code == 500
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["code"] == "internal"
    assert answer.json()["request_id"] == answer.headers["x-request-id"]
    assert "secret" not in answer.text


PLAIN = b'{"observations": ["not ok(scan)"]}'
FULL = json.dumps(
    {
        "observations": ["ok(map)"],
        "assertions": {"a": "ok(map) or ok(scan)"},
        "time": 1_700_000_000_000_000_000,
        "source": "s",
        "lifetime_s": 5,
        "together": False,
    }
).encode()


@pytest.mark.parametrize(
    ("robot", "body", "headers", "status"),
    [
        ("", PLAIN, {}, 200),
        ("", FULL, {}, 200),
        ("", PLAIN, {"Origin": "http://elsewhere.example"}, 403),
        ("", PLAIN, {"Host": "elsewhere.example"}, 421),
        ("", PLAIN, {"Idempotency-Key": "two words"}, 422),
        ("nobody", PLAIN, {}, 404),
    ],
    ids=["plain", "all fields", "another origin", "another host", "an ill-formed key", "no such robot"],
)
def test_a_request_has_the_same_answer_on_both_ways(
    service: Service, robot: str, body: bytes, headers: dict[str, str], status: int
) -> None:
    """The short way of POST …/observations, and the framework's."""
    short, long = (
        service.api("POST", f"/robots/{robot or name}/observations", content=body, headers=kind | headers)
        for name, kind in (("short", JSON), ("long", JSON_TOO))
    )
    assert alike(short) == alike(long)
    assert short.status_code == status


def test_a_key_has_its_first_answer_whichever_way_the_repeat_takes(service: Service) -> None:
    first, again = (
        service.api(
            "POST", "/robots/short/observations", content=PLAIN, headers=kind | {"Idempotency-Key": "k-1"}
        )
        for kind in (JSON, JSON_TOO)
    )
    assert first.json() == again.json()


def test_only_plain_requests_take_the_short_way(service: Service) -> None:
    route = next(r for r in service.runtime.app.routes if getattr(r, "path", "").endswith("/observations"))
    express = Express(service.runtime.app.state.parts, service.runtime.app.state.gate, route)

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


def test_metrics_name_the_route_on_both_ways(service: Service) -> None:
    service.observe("ok(odom)", robot="short")
    text = service.http.get("/metrics").text
    route = "/api/v1/robots/{robot}/observations"
    assert f'robomend_requests_total{{method="POST",route="{route}",status="200"}}' in text
