"""Answers are what the OpenAPI document says: every field is described, and each moment has its text."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest
from pydantic import BaseModel
from structlog.testing import capture_logs
from tests.api.conftest import TEDUSAR, Service, running
from tests.waiting import until

from robomend.api.routers.history import HistoryLine
from robomend.api.schemas.repair import ChoiceOut
from robomend.api.schemas.repair_record import RepairOut
from robomend.repairs.states import RepairState
from robomend.settings import Settings
from robomend.timestamps import rfc3339

WRONG = ["not ok(scan)", "not running(hokuyo_node)", "on(hokuyo)", "on(jaguar)"]


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    settings = Settings(port=0, data=tmp_path_factory.mktemp("typed"))
    with running(settings, repairs=True) as service:
        service.with_robot("r1", policy="approve", actions={"start_node": {"retries": 0}})
        service.with_robot("wired", board={"host": "127.0.0.1", "port": 1}, policy="observe")
        service.observe(*WRONG, robot="r1")
        yield service


def refs(value: Any) -> Iterator[str]:
    """Yield the names of the schemas that this part of the document speaks of."""
    if isinstance(value, dict):
        if "$ref" in value:
            yield value["$ref"].rpartition("/")[2]
        for one in value.values():
            yield from refs(one)
    elif isinstance(value, list):
        for one in value:
            yield from refs(one)


def answered(document: dict[str, Any]) -> dict[str, Any]:
    """Return the schemas of all that is answered."""
    schemas = document["components"]["schemas"]
    found: dict[str, Any] = {}
    new = {
        name
        for operations in document["paths"].values()
        for operation in operations.values()
        for name in refs(operation["responses"])
    }
    while new:
        found.update({name: schemas[name] for name in new})
        new = {name for one in new for name in refs(schemas[one])} - found.keys()
    return found


def told_in(value: Any) -> Iterator[tuple[str, int | None, Any]]:
    """Yield each moment of an answer: its name, the nanoseconds, and the text beside them."""
    if isinstance(value, dict):
        for name, one in value.items():
            if name.endswith("_ns"):
                yield name, one, value.get(name.removesuffix("_ns"), "nothing")
            yield from told_in(one)
    elif isinstance(value, list):
        for one in value:
            yield from told_in(one)


def each_is_told(answer: Any) -> int:
    """See that each moment of an answer has its text; return how many there are."""
    moments = list(told_in(answer))
    for name, time_ns, text in moments:
        assert (name, text) == (name, rfc3339(time_ns))
    return len(moments)


def described(kind: type[BaseModel], answer: dict[str, Any]) -> None:
    """See that nothing comes that is not described, and that what is described fits."""
    read = kind.model_validate_json(json.dumps(answer), strict=True).model_dump(
        mode="json", exclude_unset=True, by_alias=True
    )
    assert read == answer


def repair_of(service: Service, *states: str) -> dict[str, Any]:
    def newest() -> dict[str, Any] | None:
        items = service.api("GET", "/robots/r1/repairs").json()["items"]
        return next((one for one in items if one["state"] in states), None)

    until(newest, f"no repair is {states}", 150)
    found = newest()
    assert found is not None
    return found


def test_a_repair_is_as_described_from_beginning_to_end(service: Service) -> None:
    waiting = repair_of(service, "awaiting-approval")
    described(RepairOut, waiting)
    assert waiting["plan"][0]["state"] == "waiting"
    approved = service.api("POST", f"/repairs/{waiting['id']}", json={"decision": "approve"})
    described(RepairOut, approved.json())
    poll = {"agent": "a", "wait_s": 10.0}
    order = service.api("POST", "/robots/r1/actions/next", json=poll).json()
    service.api("POST", f"/actions/{order['id']}/feedback", json={"code": 1, "message": "half way"})
    service.api("POST", f"/actions/{order['id']}/result", json={"code": 5, "message": "it is stuck"})
    until(lambda: find(service, waiting["id"])["rounds"][0]["ending"], "the round did not end", 60)
    done = find(service, waiting["id"])
    described(RepairOut, done)
    [step] = [one for one in done["rounds"][0]["plan"] if one["result"] is not None]
    assert step["result"] == 5
    assert "it is stuck" in step["message"]
    assert step["feedback"]["message"] == "half way"
    assert done["account"]
    with capture_logs() as logged:
        service.api("POST", f"/repairs/{waiting['id']}", json={"decision": "cancel", "reason": "not now"})
        until(lambda: find(service, waiting["id"])["finished"], "it did not end", 60)
    lines = [one for one in logged if one["event"] == "repair" and one["state"] == "cancelled"]
    assert [(one["robot"], one["repair"], one["log_level"]) for one in lines] == [
        ("r1", waiting["id"], "info")
    ]
    assert "not now" in lines[0]["reason"]
    ended = find(service, waiting["id"])
    described(RepairOut, ended)
    assert ended["created"].endswith("Z")
    assert ended["created"] <= ended["finished"]
    assert each_is_told(ended) > 10  # of steps, symptoms and waits as well
    assert each_is_told(service.api("GET", "/repairs").json()) > 10


def find(service: Service, repair: str) -> dict[str, Any]:
    found: dict[str, Any] = service.api("GET", f"/repairs/{repair}").json()
    return found


@pytest.mark.parametrize("kind", ["observations", "diagnosis", "repair"])
def test_the_history_is_as_described(service: Service, kind: str) -> None:
    body = {"observations": ["ok(odom)"], "assertions": {"a": "ok(map) or ok(odom)"}}
    service.api("POST", "/robots/r1/observations", json=body)
    service.diagnosis("r1", after=0, wait_s=60)
    until(lambda: ids(service, "/robots/r1/history", kind=kind), f"there is no {kind} yet", 60)
    for item in service.api("GET", "/robots/r1/history", params={"kind": kind}).json()["items"]:
        described(HistoryLine, item)
        assert item["kind"] == kind
        assert each_is_told(item)


def test_a_repair_reads_the_same_in_the_history(service: Service) -> None:
    repair_of(service, *RepairState)

    def alike() -> bool:
        past = service.api("GET", "/robots/r1/history", params={"kind": "repair", "limit": 1}).json()["items"]
        now = service.api("GET", "/robots/r1/repairs", params={"limit": 1}).json()["items"]
        return bool([line["data"] for line in past] == now)

    until(alike, "they differ", 60)  # it may go on between the two


@pytest.mark.parametrize("pddl", [True, False])
def test_a_plan_for_a_robot_is_as_described(service: Service, pddl: bool) -> None:
    answer = service.api("POST", "/robots/r1/plans", json={"pddl": pddl}).json()
    described(ChoiceOut, answer)
    assert answer["plan"]["steps"]
    assert (answer["plan"]["pddl"] is not None) == pddl


@pytest.mark.parametrize("observed", [WRONG, ["not ok(scan)"], []])
def test_a_one_shot_plan_is_as_described(service: Service, observed: list[str]) -> None:
    answer = service.api("POST", "/plans", json={"source": TEDUSAR, "observations": observed}).json()
    described(ChoiceOut, answer)


def test_no_answer_is_an_untyped_object(service: Service) -> None:
    document = service.http.get("/openapi.json").json()
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            for status, response in operation["responses"].items():
                schema = response.get("content", {}).get("application/json", {}).get("schema", {})
                bare = schema.get("type") == "object" and schema.get("additionalProperties") in (None, True)
                assert not bare or (path == "/version-info"), f"{method} {path} {status}"
    for name, schema in answered(document).items():
        for field, kind in schema.get("properties", {}).items():
            bare = [one for one in kind.get("anyOf", [kind]) if one.get("additionalProperties") is True]
            assert not bare or field == "options", f"{name}.{field}"  # of an executor: its own


def ids(service: Service, path: str, **query: str) -> list[Any]:
    answer = service.api("GET", path, params=query)
    assert answer.status_code == 200, answer.text
    return [one.get("id", one.get("time_ns")) for one in answer.json()["items"]]


@pytest.mark.parametrize("path", ["/audit", "/robots/r1/history", "/robots/r1/repairs"])
def test_lists_over_time_are_cut_by_time(service: Service, path: str) -> None:
    until(lambda: ids(service, path), "there is nothing yet", 60)
    newest = service.api("GET", path, params={"limit": 1}).json()["items"][0]
    at = rfc3339(newest.get("created_ns", newest.get("time_ns")))
    before = ids(service, path, until=at)
    after = ids(service, path, since=at)
    assert ids(service, path)[:1] == after[:1]
    assert not set(before) & set(after)
    assert ids(service, path, since="9999-12-31T23:59:59Z") == []
    assert ids(service, path, until="0001-01-01T00:00:00+00:00") == []
    offset = at.replace("Z", "+00:00")
    assert ids(service, path, since=offset) == after
    for wrong in ("yesterday", "2025-11-24T16:00:00"):  # whose time would that be?
        assert service.api("GET", path, params={"since": wrong}).status_code == 422


def test_repairs_are_asked_for_by_state(service: Service) -> None:
    every = service.api("GET", "/robots/r1/repairs").json()["items"]
    for state in {one["state"] for one in every}:
        expected = [one["id"] for one in every if one["state"] == state]
        assert ids(service, "/robots/r1/repairs", state=state) == expected
    assert ids(service, "/robots/r1/repairs", state="failed") == []
    assert service.api("GET", "/robots/r1/repairs", params={"state": "odd"}).status_code == 422


def test_the_audit_log_is_asked_for_by_who_and_what(service: Service) -> None:
    every = service.api("GET", "/audit", params={"limit": 1000}).json()["items"]
    put = [one["id"] for one in every if one["action"] == "robot.put"]
    assert put
    assert ids(service, "/audit", action="robot.put") == put
    assert ids(service, "/audit", action="robot.put", actor="local") == put
    assert ids(service, "/audit", actor="nobody") == []


def test_each_moment_of_the_document_has_its_text(service: Service) -> None:
    schemas = answered(service.http.get("/openapi.json").json())
    moments = [
        (name, field)
        for name, schema in schemas.items()
        for field in schema.get("properties", {})
        if field.endswith("_ns")
    ]
    assert {"RepairOut", "AuditedStop", "CurrentDiagnosis", "StepFeedback"} <= {name for name, _ in moments}
    for name, field in moments:
        fields, required = schemas[name]["properties"], schemas[name].get("required", [])
        text = field.removesuffix("_ns")
        assert text in fields, f"{name}.{field} has no {text}"
        kinds = fields[text].get("anyOf", [fields[text]])
        assert kinds[0]["format"] == "date-time", f"{name}.{text}"
        nullable = {"type": "null"} in fields[field].get("anyOf", [])
        assert ({"type": "null"} in kinds) == nullable, f"{name}.{text}"
        assert field not in required or text in required, f"{name}.{text}"


@pytest.mark.parametrize(
    ("path", "least"),
    [
        ("/models/tedusar/versions", 1),
        ("/robots/r1", 2),
        ("/robots/r1/observations", 6),
        ("/robots/r1/diagnosis", 1),
        ("/robots/wired/board", 1),
        ("/audit", 1),
        ("/stop", 1),
    ],
)
def test_each_moment_of_an_answer_has_its_text(service: Service, path: str, least: int) -> None:
    answer = service.api("GET", path)
    assert answer.status_code == 200, answer.text
    assert each_is_told(answer.json()) >= least


@pytest.mark.parametrize(
    ("time_ns", "text"),
    [
        (0, "1970-01-01T00:00:00.000Z"),
        (1_764_000_000_123_999_999, "2025-11-24T16:00:00.123Z"),
        (2**63 - 1, "2262-04-11T23:47:16.854Z"),
        (-1, "1969-12-31T23:59:59.999Z"),
        (None, None),
    ],
)
def test_a_moment_as_text_is_cut_to_the_millisecond(time_ns: int | None, text: str | None) -> None:
    assert rfc3339(time_ns) == text
