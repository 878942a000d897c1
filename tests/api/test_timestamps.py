"""Every moment comes as nanoseconds and as RFC 3339 text: in the document, and in what is answered."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from tests.api.conftest import Service

from robomend.timestamps import rfc3339, with_texts

DURATIONS: frozenset[str] = frozenset()
"""Names in `_ns` that are no moments. A new one goes here; a moment gets its text."""


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
            if name.endswith("_ns") and name not in DURATIONS:
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


def test_each_moment_of_the_document_has_its_text(service: Service) -> None:
    schemas = answered(service.http.get("/openapi.json").json())
    moments = [
        (name, field)
        for name, schema in schemas.items()
        for field in schema.get("properties", {})
        if field.endswith("_ns") and field not in DURATIONS
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


@pytest.fixture(scope="module")
def told(service: Service) -> Service:
    service.with_robot("m1", board={"host": "127.0.0.1", "port": 1})
    body = {"observations": ["ok(scan)"], "assertions": {"a": "ok(map) or ok(odom)"}, "lifetime_s": 60}
    service.api("POST", "/robots/m1/observations", json=body)
    service.diagnosis("m1", after=0, wait_s=60)
    service.api("POST", "/stop", json={"reason": "a moment"})
    return service


@pytest.mark.parametrize(
    ("path", "least"),
    [
        ("/models", 1),
        ("/models/tedusar", 1),
        ("/models/tedusar/versions", 1),
        ("/robots", 1),
        ("/robots/m1", 2),
        ("/robots/m1/observations", 6),
        ("/robots/m1/diagnosis", 1),
        ("/robots/m1/history", 1),
        ("/robots/m1/history?kind=diagnosis", 1),
        ("/robots/m1/repairs", 3),
        ("/repairs/r-1", 3),
        ("/robots/m1/board", 1),
        ("/status", 1),
        ("/audit", 1),
        ("/stop", 1),
        ("/session", 1),
    ],
)
def test_each_moment_of_an_answer_has_its_text(told: Service, path: str, least: int) -> None:
    answer = told.api("GET", path)
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


def test_texts_are_added_where_there_are_moments_and_nowhere_else() -> None:
    said = {"a_ns": 0, "b_ns": None, "b": "kept", "c": [{"d_ns": 0, "e": ("x",)}], "f_ns": "words"}
    assert with_texts(said) == {
        **said,
        "a": "1970-01-01T00:00:00.000Z",
        "c": [{"d_ns": 0, "d": "1970-01-01T00:00:00.000Z", "e": ["x"]}],
    }
